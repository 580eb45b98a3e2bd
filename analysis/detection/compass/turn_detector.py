"""Detects compass and gyro that turn differently, without filter or attitude.

A gyro bias about the vertical turns the heading and nothing else: neither the ranges of a hovering
vehicle nor the size of the field show it.
"""

from typing import ClassVar

import numpy as np

from analysis.detection.compass.turn_kernel import (
    EITHER,
    FIELD,
    RATES,
    TurnState,
    new_turns,
    track_turns,
)
from analysis.detection.detector_registry import BlockDetector
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import Block

SENSOR_OF = {FIELD: "mag", RATES: "imu", EITHER: "imu"}
HYPOTHESIS_OF = {FIELD: "", RATES: "", EITHER: "imu-or-mag"}


class TurnDetector(BlockDetector, frozen=True):
    """Compares the turns over four seconds."""

    channels: ClassVar = frozenset({"imu", "mag"})

    def new_state(self) -> TurnState:
        """No sample has come yet."""
        return new_turns()

    def step(
        self, block: Block, state: TurnState
    ) -> tuple[list[tuple[int, SensorDecision]], TurnState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        faulty, turned_rad = track_turns(block.kind, block.t_us, block.values, state)
        return [
            (row, turn_alarm(int(block.t_us[row]), int(faulty[row]), float(turned_rad[row]), 4))
            for row in np.flatnonzero(faulty).tolist()
        ], state


def turn_alarm(t_us: int, faulty: int, turned_rad: float, for_s: int) -> SensorDecision:
    """The alarm for a faulty sensor and a difference of the turns in so many seconds."""
    return pattern_alarm(
        t_us,
        SENSOR_OF[faulty],
        f"compass and gyro turned {np.degrees(turned_rad):.0f} degrees apart in {for_s} s",
        suspect=HYPOTHESIS_OF[faulty],
        isolated=faulty != EITHER,
    )
