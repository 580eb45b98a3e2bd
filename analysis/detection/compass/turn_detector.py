"""Compass and gyro that do not turn alike: a step of the pipeline without filter and attitude.

A gyro's bias about the vertical turns the heading and nothing else, so that neither the ranges of a
hovering vehicle nor the field's size show it.
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
    """A step of the pipeline."""

    channels: ClassVar = frozenset({"imu", "mag"})

    def new_state(self) -> TurnState:
        """Nothing came yet."""
        return new_turns()

    def step(
        self, block: Block, state: TurnState
    ) -> tuple[list[tuple[int, SensorDecision]], TurnState]:
        """Who turns otherwise, by the row that shows it, and the next state.

        The state is changed in place.
        """
        who, off = track_turns(block.kind, block.t_us, block.values, state)
        return [
            (row, turn_alarm(int(block.t_us[row]), int(who[row]), float(off[row]), 4))
            for row in np.flatnonzero(who).tolist()
        ], state


def turn_alarm(t_us: int, who: int, off_rad: float, for_s: int) -> SensorDecision:
    """The alarm, by who is at fault and how far they turned apart in so many seconds."""
    return pattern_alarm(
        t_us,
        SENSOR_OF[who],
        f"compass and gyro turned {np.degrees(off_rad):.0f} degrees apart in {for_s} s",
        suspect=HYPOTHESIS_OF[who],
        isolated=who != EITHER,
    )
