"""Detection and isolation of faults on pseudoranges; docs/fdi.md has the equations."""

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector import Detector
from analysis.detection.filter.filter_config import ProcessNoise
from analysis.detection.filter.range_noise import SigmaModel

__all__ = ["Detector", "DetectorConfig", "ProcessNoise", "SigmaModel"]
