"""Detection and isolation of faults on pseudoranges; docs/fdi.md has the equations."""

from analysis.detection.detection_config import DetectorConfig, ProcessNoise, SigmaModel
from analysis.detection.detector import Detector

__all__ = ["Detector", "DetectorConfig", "ProcessNoise", "SigmaModel"]
