"""What a detector of another package imports; `mavproxy-fault new detector NAME` writes one."""

from analysis.detection.detector_registry import BlockDetector
from analysis.results import SensorDecision
from analysis.samples.block import (
    AIRSPEED,
    BARO,
    EPOCH,
    FIX,
    IMU,
    MAG,
    RANGE,
    VISION,
    Block,
    block_of,
)

__all__ = [
    "AIRSPEED", "BARO", "EPOCH", "FIX", "IMU", "MAG", "RANGE", "VISION", "Block", "BlockDetector",
    "SensorDecision", "block_of",
]  # fmt: skip
