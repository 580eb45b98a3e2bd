"""Detects a tumble that is faster than the gyro's range (docs/watches.md).

A saturated gyro repeats its value while the body turns on. The attitude is lost after a tumble,
which voids the tests; after an impact, for the rest of the flight.
"""

import math
from dataclasses import dataclass

import numpy as np

from analysis.detection.actuators.alarm_precedence import IMPACT_MPS2, RELEARNED_US
from analysis.detection.compass.compass_samples import ZERO, Axis, compass_samples, dot
from analysis.results import FOREVER_US
from analysis.samples.block import IMU, MAG, NEVER_US, Block, Stamps

# The smallest range of common gyros is 250 degrees/s (4.36 rad/s), a little less if calibrated.
GYRO_RANGE_RPS = 4.0
# Largest relative change of a saturated rate, from which 4 rad/s depart within 20 ms at 1 rad/s^2,
# and samples in a row that confirm it.
SATURATED_SHARE, SATURATED_SAMPLES = 0.005, 5
TURNED_COSINE = 0.87758  # cosine of 0.5 rad, the turn of the field since a mark
MARK_US = 500_000  # between marks of the field


@dataclass(slots=True)
class TumbleState:
    """The newest rates, saturated samples in a row, two marks of the field in the body, the older
    one 0.5 to 1 s old, and until when the attitude is lost."""

    rates: Axis = ZERO
    count: int = 0
    older: Axis = ZERO
    younger: Axis = ZERO
    marked_us: int = NEVER_US
    until_us: int = NEVER_US


def track_tumble(block: Block, state: TumbleState) -> Stamps:
    """Until when the attitude is lost, by row (n,); the state is changed in place."""
    until = np.full(len(block.kind), NEVER_US)
    if len(until):
        until[0] = state.until_us
    for row, kind, t_us, values in compass_samples(block):
        x, y, z, *force = values
        if kind == IMU:
            saturated = any(
                abs(rate) > GYRO_RANGE_RPS and abs(rate - before) <= SATURATED_SHARE * abs(rate)
                for rate, before in zip((x, y, z), state.rates, strict=True)
            )
            state.rates, state.count = (x, y, z), state.count + 1 if saturated else 0
            if t_us < state.until_us and math.hypot(*force[:3]) > IMPACT_MPS2:
                until[row] = state.until_us = FOREVER_US
        elif kind == MAG:
            if state.count >= SATURATED_SAMPLES and _field_turned((x, y, z), state.older):
                until[row] = state.until_us = max(state.until_us, t_us + RELEARNED_US)
            if not 0 <= t_us - state.marked_us < MARK_US:
                state.older, state.younger, state.marked_us = state.younger, (x, y, z), t_us
    return np.maximum.accumulate(until)


def _field_turned(field: Axis, before: Axis) -> bool:
    """Whether the field points in another direction in the body than before."""
    size_sq = dot(field, field) * dot(before, before)
    return dot(before, before) > 0.0 and dot(field, before) < TURNED_COSINE * math.sqrt(size_sq)
