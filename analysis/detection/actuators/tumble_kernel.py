"""Whether the body tumbles faster than its gyro can tell, compiled.

A gyro at the end of its range stands there while the body turns on. What turns so fast is taken for
real if the compass turns too: a gyro that is at fault stands as well, but nothing else moves. After
that the attitude is lost, and with it whatever is held against it; if a blow follows, for good.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import IMU, IMU_ID, MAG, Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

# The least range of a gyro in use is 250 degrees/s; calibrated, it may end a little earlier.
GYRO_RANGE_RPS = 4.0
SATURATED_SHARE, SATURATED_SAMPLES = (
    0.005,
    5,
)  # share by which a rate may differ from the one before; how often
TURNED_COSINE = 0.87758  # cosine of 0.5 rad, by which the field turned in the body since a mark
MARK_US = 500_000  # between marks
LOST_US = 20_000_000  # as long as a sensor is held out, and the attitude found anew
IMPACT_MPS2 = 100.0  # specific force of no manoeuvre
NEVER_US = -(1 << 62)
FOREVER_US = 1 << 62

COUNT, MARKED_US, UNTIL_US = range(3)  # of `numbers`


class TumbleState(NamedTuple):
    """`rates` (3,) the newest; `marks` (2, 3) of the field in the body, half a second to a second
    old and younger; `numbers` (3,): samples at the end of the range, the younger mark's stamp, and
    until when the attitude is lost. `track_tumble` changes them."""

    rates: Vector
    marks: Vector
    numbers: NDArray[np.int64]


def new_tumble() -> TumbleState:
    """Nothing came yet."""
    return TumbleState(np.zeros(3), np.zeros((2, 3)), np.array([0, NEVER_US, NEVER_US]))


@compiled
def track_tumble(
    kind: Indices, t_us: Stamps, values: Vector, kept: TumbleState
) -> NDArray[np.bool_]:
    """Whether the attitude is lost at each row (n,)."""
    lost = np.zeros(len(kind), np.bool_)
    numbers = kept.numbers
    for i in range(len(kind)):
        if kind[i] == IMU and values[i, IMU_ID] < 0.5:
            _add_gyro(t_us[i], values[i], kept)
        elif (
            kind[i] == MAG
            and numbers[COUNT] >= SATURATED_SAMPLES
            and _field_turned(values[i], kept.marks[0])
        ):
            numbers[UNTIL_US] = max(numbers[UNTIL_US], t_us[i] + LOST_US)
        if kind[i] == MAG and not 0 <= t_us[i] - numbers[MARKED_US] < MARK_US:
            kept.marks[0] = kept.marks[1]
            kept.marks[1] = values[i, :3]
            numbers[MARKED_US] = t_us[i]
        lost[i] = t_us[i] < numbers[UNTIL_US]
    return lost


@compiled
def _add_gyro(t_us: int, sample: Vector, kept: TumbleState) -> None:
    """Take a sample of the IMU."""
    stands = False
    square = 0.0
    for i in range(3):
        rate = sample[i]
        stands |= abs(rate) > GYRO_RANGE_RPS and abs(rate - kept.rates[i]) <= SATURATED_SHARE * abs(
            rate
        )
        kept.rates[i] = rate
        square += sample[3 + i] ** 2
    kept.numbers[COUNT] = kept.numbers[COUNT] + 1 if stands else 0
    if square > IMPACT_MPS2**2 and t_us < kept.numbers[UNTIL_US]:
        kept.numbers[UNTIL_US] = FOREVER_US


@compiled
def _field_turned(field: Vector, before: Vector) -> bool:
    """Whether the field points elsewhere in the body than before."""
    dot = size = size_before = 0.0
    for i in range(3):
        dot += field[i] * before[i]
        size += field[i] ** 2
        size_before += before[i] ** 2
    return size_before > 0.0 and dot < TURNED_COSINE * sqrt(size * size_before)
