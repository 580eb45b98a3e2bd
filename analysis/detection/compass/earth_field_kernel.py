"""Whether the field is the Earth's at this place, compiled: its size, and its angle to gravity.

Both are means of a second. The angle is asked only while the specific force has the size of
gravity, which it has not in a turn or a climb.
"""

from math import asin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import FORCE, IMU, IMU_ID, MAG
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

NOMINAL, SIZE, ANGLE = range(3)  # what is off
# What PX4 1.18 allows by default (EKF2_MAG_CHK_STR, EKF2_MAG_CHK_INC), who refuses the compass then
MOST_GAUSS, MOST_RAD = 0.2, 0.349
CONFIRM_WINDOWS = 5  # windows in a row
WINDOW_US = 1_000_000
LEAST_SAMPLES = 3  # samples of a mean
FORCE_MPS2 = 0.5  # that the mean specific force may differ from gravity
STEADY_SHARE = 0.8  # of the mean size in the mean field: it did not turn meanwhile

NUMBER, FIELDS, FORCES, SIZE_RUN, ANGLE_RUN, COUNTS = 0, 1, 2, 3, 4, 5
FIELD, STRENGTH, FORCE_SUM, SUMS = 0, 3, 4, 7  # of the sums: field, its size, specific force


class EarthField(NamedTuple):
    """`model` (2,): the field's size in gauss and its inclination in rad, NaN where no place is
    known; `sums` (SUMS,) of the window that is being filled; `counts` (COUNTS,): its number, how
    many samples of each kind, windows in a row that were off. `track_earth_field` changes them."""

    model: Vector
    sums: Vector
    counts: NDArray[np.int64]


def new_earth_field() -> EarthField:
    """Nothing came yet."""
    return EarthField(np.full(2, np.nan), np.zeros(SUMS), np.zeros(COUNTS, np.int64))


@compiled
def track_earth_field(
    kind: NDArray[np.int64], t_us: NDArray[np.int64], values: Vector, kept: EarthField
) -> tuple[NDArray[np.int64], Vector]:
    """What (n,) is off where that is to be told, FINE elsewhere, and by how much (n,)."""
    what, off = np.zeros(len(kind), np.int64), np.zeros(len(kind))
    for i in range(len(kind)):
        own = kind[i] == MAG or (kind[i] == IMU and values[i, IMU_ID] < 0.5)
        if not own:
            continue
        number = t_us[i] // WINDOW_US
        if number != kept.counts[NUMBER]:
            what[i], off[i] = _test_window(kept)
            if abs(number - kept.counts[NUMBER]) > CONFIRM_WINDOWS:
                kept.counts[SIZE_RUN:] = 0
            kept.counts[NUMBER] = number
            kept.counts[FIELDS : FORCES + 1] = 0
            kept.sums[:] = 0.0
        _add(kind[i], values[i], kept)
    return what, off


@compiled
def _add(kind: int, numbers: Vector, kept: EarthField) -> None:
    first, to = (FIELD, FIELDS) if kind == MAG else (FORCE_SUM, FORCES)
    begin = 0 if kind == MAG else FORCE
    square = 0.0
    for i in range(3):
        square += numbers[begin + i] ** 2
    if not np.isfinite(square):
        return
    for i in range(3):
        kept.sums[first + i] += numbers[begin + i]
    if kind == MAG:
        kept.sums[STRENGTH] += sqrt(square)
    kept.counts[to] += 1


@compiled
def _test_window(kept: EarthField) -> tuple[int, float]:
    """Judge a full window."""
    sums, counts = kept.sums, kept.counts
    if counts[FIELDS] < LEAST_SAMPLES or np.isnan(kept.model[0]):
        return NOMINAL, 0.0
    size = sums[STRENGTH] / counts[FIELDS]
    more = size - kept.model[0]
    counts[SIZE_RUN] = counts[SIZE_RUN] + 1 if abs(more) > MOST_GAUSS else 0
    further = _inclination_error(kept, size)
    if not np.isnan(further):  # where it cannot be asked it stays as it was
        counts[ANGLE_RUN] = counts[ANGLE_RUN] + 1 if abs(further) > MOST_RAD else 0
    if counts[SIZE_RUN] >= CONFIRM_WINDOWS:
        return SIZE, more
    if counts[ANGLE_RUN] >= CONFIRM_WINDOWS and not np.isnan(further):
        return ANGLE, further
    return NOMINAL, 0.0


@compiled
def _inclination_error(kept: EarthField, size: float) -> float:
    """How far the field is inclined beyond the model, NaN where that is not known."""
    sums, fields, forces = kept.sums, kept.counts[FIELDS], kept.counts[FORCES]
    if forces < LEAST_SAMPLES:
        return np.nan
    along = square = pull = 0.0
    for i in range(3):
        field, force = sums[FIELD + i] / fields, sums[FORCE_SUM + i] / forces
        along += field * force
        square += field * field
        pull += force * force
    field, force = sqrt(square), sqrt(pull)
    if (
        abs(force - STANDARD_GRAVITY_MPS2) > FORCE_MPS2
        or field < STEADY_SHARE * size
        or field == 0.0
    ):
        return np.nan
    # At rest the specific force points up.
    down = min(1.0, max(-1.0, -along / (field * force)))
    further: float = asin(down) - kept.model[1]
    return further
