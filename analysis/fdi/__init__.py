"""Detection and isolation of faults on pseudoranges; docs/fdi.md has the equations."""

from analysis.fdi.config import DetectorConfig, Noise, SigmaModel
from analysis.fdi.detector import Detector

__all__ = ["Detector", "DetectorConfig", "Noise", "SigmaModel"]
