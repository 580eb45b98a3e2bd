"""Compares the field's size, and its angle to gravity, with the Earth's field, compiled.

Both are means over a second. The angle is tested only while the specific force has the size of
gravity, that is not in turns or climbs.
"""

from math import asin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import FORCE, IMU, IMU_ID, MAG
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

NOMINAL, SIZE, ANGLE = range(3)  # the test that failed
# Defaults of PX4 1.18, which refuses a compass beyond them: EKF2_MAG_CHK_STR, EKF2_MAG_CHK_INC
MOST_GAUSS, MOST_RAD = 0.2, 0.349
CONFIRM_WINDOWS = 5  # windows in a row, chosen: turns and manoeuvres are shorter
WINDOW_US = 1_000_000
LEAST_SAMPLES = 3  # samples of a mean, chosen
FORCE_MPS2 = 0.5  # deviation of the mean specific force from gravity: 5 %
STEADY_SHARE = 0.8  # size of the mean field over the mean size: it did not turn meanwhile

NUMBER, FIELDS, FORCES, SIZE_RUN, ANGLE_RUN, COUNTS = 0, 1, 2, 3, 4, 5
FIELD, STRENGTH, FORCE_SUM, SUMS = 0, 3, 4, 7  # of the sums: field, its size, specific force


class EarthField(NamedTuple):
    """`model` (2,): the field's size in gauss and its inclination in rad, NaN while no place is
    known; `sums` (SUMS,) of the window that is being filled; `counts` (COUNTS,): its number,
    samples of each kind, failed windows in a row. `track_earth_field` changes them."""

    model: Vector
    sums: Vector
    counts: NDArray[np.int64]


def new_earth_field() -> EarthField:
    """No sample has come yet."""
    return EarthField(np.full(2, np.nan), np.zeros(SUMS), np.zeros(COUNTS, np.int64))


@compiled
def track_earth_field(
    kind: NDArray[np.int64], t_us: NDArray[np.int64], values: Vector, state: EarthField
) -> tuple[NDArray[np.int64], Vector]:
    """The failed test (n,) where a result is due, NOMINAL elsewhere, and the error (n,)."""
    test, error = np.zeros(len(kind), np.int64), np.zeros(len(kind))
    for i in range(len(kind)):
        own = kind[i] == MAG or (kind[i] == IMU and values[i, IMU_ID] < 0.5)
        if not own:
            continue
        number = t_us[i] // WINDOW_US
        if number != state.counts[NUMBER]:
            test[i], error[i] = _test_window(state)
            if abs(number - state.counts[NUMBER]) > CONFIRM_WINDOWS:
                state.counts[SIZE_RUN:] = 0
            state.counts[NUMBER] = number
            state.counts[FIELDS : FORCES + 1] = 0
            state.sums[:] = 0.0
        _add(kind[i], values[i], state)
    return test, error


@compiled
def _add(kind: int, values: Vector, state: EarthField) -> None:
    first, counter = (FIELD, FIELDS) if kind == MAG else (FORCE_SUM, FORCES)
    begin = 0 if kind == MAG else FORCE
    square = 0.0
    for i in range(3):
        square += values[begin + i] ** 2
    if not np.isfinite(square):
        return
    for i in range(3):
        state.sums[first + i] += values[begin + i]
    if kind == MAG:
        state.sums[STRENGTH] += sqrt(square)
    state.counts[counter] += 1


@compiled
def _test_window(state: EarthField) -> tuple[int, float]:
    """Test a full window."""
    sums, counts = state.sums, state.counts
    if counts[FIELDS] < LEAST_SAMPLES or np.isnan(state.model[0]):
        return NOMINAL, 0.0
    size = sums[STRENGTH] / counts[FIELDS]
    size_error = size - state.model[0]
    counts[SIZE_RUN] = counts[SIZE_RUN] + 1 if abs(size_error) > MOST_GAUSS else 0
    angle_error = _inclination_error(state, size)
    if not np.isnan(angle_error):  # without an angle the count stays
        counts[ANGLE_RUN] = counts[ANGLE_RUN] + 1 if abs(angle_error) > MOST_RAD else 0
    if counts[SIZE_RUN] >= CONFIRM_WINDOWS:
        return SIZE, size_error
    if counts[ANGLE_RUN] >= CONFIRM_WINDOWS and not np.isnan(angle_error):
        return ANGLE, angle_error
    return NOMINAL, 0.0


@compiled
def _inclination_error(state: EarthField, size: float) -> float:
    """How much steeper the field is than the model's, NaN if that is unknown."""
    sums, fields, forces = state.sums, state.counts[FIELDS], state.counts[FORCES]
    if forces < LEAST_SAMPLES:
        return np.nan
    along = square = force_sq = 0.0
    for i in range(3):
        field, force = sums[FIELD + i] / fields, sums[FORCE_SUM + i] / forces
        along += field * force
        square += field * field
        force_sq += force * force
    field, force = sqrt(square), sqrt(force_sq)
    if (
        abs(force - STANDARD_GRAVITY_MPS2) > FORCE_MPS2
        or field < STEADY_SHARE * size
        or field == 0.0
    ):
        return np.nan
    # At rest the specific force points up.
    down = min(1.0, max(-1.0, -along / (field * force)))
    angle_error: float = asin(down) - state.model[1]
    return angle_error
