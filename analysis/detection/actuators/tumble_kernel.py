"""Detects a tumble that is faster than the gyro's range, compiled.

A gyro at the end of its range repeats its value while the body turns on. The tumble is real if the
compass turns too; a faulty gyro repeats its value as well, but nothing else moves. After a tumble
the attitude is lost, which voids the tests; after an impact, for the rest of the flight.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import IMU, IMU_ID, MAG, NEVER_US, Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

# The smallest range of common gyros is 250 degrees/s (4.36 rad/s), a little less if calibrated.
GYRO_RANGE_RPS = 4.0
# Largest relative change of a saturated rate, and samples in a row that confirm it; chosen.
SATURATED_SHARE, SATURATED_SAMPLES = 0.005, 5
TURNED_COSINE = 0.87758  # cosine of 0.5 rad, the turn of the field since a mark
MARK_US = 500_000  # between marks of the field
LOST_US = 20_000_000  # hold time of a sensor and the time to find the attitude again
IMPACT_MPS2 = 100.0  # specific force of 10 g, as in actuator_response
FOREVER_US = 1 << 62

COUNT, MARKED_US, UNTIL_US = range(3)  # of `numbers`


class TumbleState(NamedTuple):
    """`rates` (3,) are the newest; `marks` (2, 3) of the field in the body, the older one 0.5 to 1
    s old; `numbers` (3,): saturated samples in a row, the younger mark's stamp, and until when the
    attitude is lost. `track_tumble` changes them."""

    rates: Vector
    marks: Vector
    numbers: NDArray[np.int64]


def new_tumble() -> TumbleState:
    """No sample has come yet."""
    return TumbleState(np.zeros(3), np.zeros((2, 3)), np.array([0, NEVER_US, NEVER_US]))


@compiled
def track_tumble(
    kind: Indices, t_us: Stamps, values: Vector, state: TumbleState
) -> NDArray[np.bool_]:
    """Whether the attitude is lost at each row (n,)."""
    lost = np.zeros(len(kind), np.bool_)
    numbers = state.numbers
    for i in range(len(kind)):
        if kind[i] == IMU and values[i, IMU_ID] < 0.5:
            _add_gyro(t_us[i], values[i], state)
        elif (
            kind[i] == MAG
            and numbers[COUNT] >= SATURATED_SAMPLES
            and _field_turned(values[i], state.marks[0])
        ):
            numbers[UNTIL_US] = max(numbers[UNTIL_US], t_us[i] + LOST_US)
        if kind[i] == MAG and not 0 <= t_us[i] - numbers[MARKED_US] < MARK_US:
            state.marks[0] = state.marks[1]
            state.marks[1] = values[i, :3]
            numbers[MARKED_US] = t_us[i]
        lost[i] = t_us[i] < numbers[UNTIL_US]
    return lost


@compiled
def _add_gyro(t_us: int, sample: Vector, state: TumbleState) -> None:
    """Add a sample of the IMU."""
    saturated = False
    square = 0.0
    for i in range(3):
        rate = sample[i]
        saturated |= abs(rate) > GYRO_RANGE_RPS and abs(
            rate - state.rates[i]
        ) <= SATURATED_SHARE * abs(rate)
        state.rates[i] = rate
        square += sample[3 + i] ** 2
    state.numbers[COUNT] = state.numbers[COUNT] + 1 if saturated else 0
    if square > IMPACT_MPS2**2 and t_us < state.numbers[UNTIL_US]:
        state.numbers[UNTIL_US] = FOREVER_US


@compiled
def _field_turned(field: Vector, before: Vector) -> bool:
    """Whether the field points in another direction in the body than before."""
    dot = size = size_before = 0.0
    for i in range(3):
        dot += field[i] * before[i]
        size += field[i] ** 2
        size_before += before[i] ** 2
    return size_before > 0.0 and dot < TURNED_COSINE * sqrt(size * size_before)
