"""Whether the compass turns as the gyro does, compiled; neither attitude nor filter is needed.

The gyro's rates, integrated, carry the measured field into a frame that does not rotate: there it
stays where it is while both are sound. Its means over half a second are held against that of four
seconds before. A compass of which the calibration is poor errs more the further it has turned,
which the limit allows for; of the two turns the smaller counts, as the larger may be the fault's.
"""

from math import atan2, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import IMU, IMU_ID, MAG
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    quaternion_of_rotation,
    rotate_in_place,
    rotation_matrix,
)

NO_HYPOTHESIS, FIELD, RATES, EITHER = range(4)  # who is at fault
BIN_US, BIN_COUNT = 500_000, 8
GAP_US, STEP_US = 100_000, 150_000  # of the gyro; between two fields that may show a jump
STEP_RAD = 0.1  # of the gyro: what turns further between two samples is not known well
# Between samples so far apart shaking passes for a slow turn: if the rates change by so much more
SPARSE_GYRO_US, SHAKING_RPS = 30_000, 0.1
LEAST_RAD, TURN_SHARE, MOST_RAD = (
    0.08,
    0.3,
    0.35,
)  # limit: LEAST + SHARE * turn, which is MOST at most
FIELD_PER_TURN = 3.0  # turns about an axis near the field's change its direction less
CONFIRM_BINS = 2  # cells in a row
SIZE_SHARE = 0.1  # share by which a sound field keeps its size
JUMP_RAD, JUMP_SHARE = 0.15, 0.7  # of one step of the field: no vehicle turns as fast
# So far a field does not turn and keep its size: it is the gyro.
GYRO_RAD = 0.6
NEVER_US = -(1 << 62)

GYRO, FIELD_US, BIN_NUMBER = range(3)  # stamps
FILLED, OVER, COUNT = range(3)
# Columns of a cell: field in both frames and its size, attitude, the two greatest jumps
W, M, NORM, Q, JUMP, SECOND, WIDE = 0, 3, 6, 7, 11, 12, 13


class TurnState(NamedTuple):
    """`q` (4,) body to the frame; `rates` (3,) the newest; `field` (2, 3) the newest, in the frame
    and in the body; `stamps` and `counts` (3,); `cells` (1 + CELLS, WIDE), oldest first, and `sums`
    (WIDE,) of the one that is being filled. `track_turns` changes them."""

    q: Vector
    rates: Vector
    field: Vector
    stamps: NDArray[np.int64]
    counts: NDArray[np.int64]
    cells: Vector
    sums: Vector


def new_turns() -> TurnState:
    """Nothing came yet."""
    return TurnState(
        np.array([1.0, 0.0, 0.0, 0.0]),
        np.zeros(3),
        np.zeros((2, 3)),
        np.full(3, NEVER_US),
        np.zeros(3, np.int64),
        np.zeros((1 + BIN_COUNT, WIDE)),
        np.zeros(WIDE),
    )


@compiled
def track_turns(
    kind: NDArray[np.int64], t_us: NDArray[np.int64], values: Vector, kept: TurnState
) -> tuple[NDArray[np.int64], Vector]:
    """Who (n,) is at fault where that is to be told, NOBODY elsewhere, and by how many rad (n,)."""
    who, off = np.zeros(len(kind), np.int64), np.zeros(len(kind))
    for i in range(len(kind)):
        if kind[i] == IMU and values[i, IMU_ID] < 0.5:
            _add_gyro(t_us[i], values[i], kept)
        elif kind[i] == MAG:
            who[i], off[i] = _add_field(t_us[i], values[i], kept)
    return who, off


@compiled
def _add_gyro(t_us: int, rates: Vector, kept: TurnState) -> None:
    """Integrate the gyro up to a sample."""
    elapsed_us = t_us - kept.stamps[GYRO]
    known = kept.stamps[GYRO] != NEVER_US and 0 <= elapsed_us <= GAP_US
    if not known or not np.isfinite(rates[0] + rates[1] + rates[2]):
        _restart(kept)
    elif elapsed_us > 0:
        half_s = 0.5e-6 * elapsed_us
        x, y, z = [half_s * (rates[i] + kept.rates[i]) for i in range(3)]
        if x * x + y * y + z * z > STEP_RAD**2 or (
            elapsed_us > SPARSE_GYRO_US and _change_sq(rates, kept.rates) > SHAKING_RPS**2
        ):
            _restart(kept)
        rotate_in_place(kept.q, quaternion_of_rotation(x, y, z))
    kept.stamps[GYRO] = t_us
    for i in range(3):
        kept.rates[i] = rates[i] if np.isfinite(rates[i]) else 0.0


@compiled
def _change_sq(rates: Vector, before: Vector) -> float:
    total = 0.0
    for i in range(3):
        total += (rates[i] - before[i]) ** 2
    return total


@compiled
def _restart(kept: TurnState) -> None:
    """Forget the past, of which a part is missing."""
    kept.counts[:] = 0
    kept.sums[:] = 0.0


@compiled
def _add_field(t_us: int, field: Vector, kept: TurnState) -> tuple[int, float]:
    """Take a sample of the field; who is at fault where it ends a cell."""
    m = field[:3].copy()
    size = sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
    repeated = m[0] == kept.field[1, 0] and m[1] == kept.field[1, 1] and m[2] == kept.field[1, 2]
    # A field that is only repeated does not tell that the vehicle stands.
    if not 0.0 < size < np.inf or repeated:
        return NO_HYPOTHESIS, 0.0
    if kept.stamps[GYRO] == NEVER_US or abs(t_us - kept.stamps[GYRO]) > GAP_US:
        _restart(kept)
        return NO_HYPOTHESIS, 0.0
    who, off = NO_HYPOTHESIS, 0.0
    cell = t_us // BIN_US
    if cell != kept.stamps[BIN_NUMBER]:
        if cell == kept.stamps[BIN_NUMBER] + 1 and kept.counts[COUNT] > 1:
            who, off = _test_bins(kept)
        else:
            _restart(kept)
        kept.stamps[BIN_NUMBER] = cell
        kept.counts[COUNT] = 0
        kept.sums[:] = 0.0
    w = np.dot(rotation_matrix(kept.q), m)
    if 0 < t_us - kept.stamps[FIELD_US] <= STEP_US:
        jump = min(_angle(w, kept.field[0]), _angle(m, kept.field[1]))
        kept.sums[SECOND] = max(kept.sums[SECOND], min(jump, kept.sums[JUMP]))
        kept.sums[JUMP] = max(kept.sums[JUMP], jump)
    kept.field[0], kept.field[1], kept.stamps[FIELD_US] = w, m, t_us
    kept.counts[COUNT] += 1
    kept.sums[W : W + 3] += w
    kept.sums[M:NORM] += m
    kept.sums[NORM] += size
    return who, off


@compiled
def _angle(a: Vector, b: Vector) -> float:
    """Between two directions (3,), rad."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return atan2(sqrt(x * x + y * y + z * z), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def _test_bins(kept: TurnState) -> tuple[int, float]:
    """Close the cell; who is at fault, and by how many rad."""
    cells, counts = kept.cells, kept.counts
    for i in range(BIN_COUNT):
        cells[i] = cells[i + 1]
    cells[BIN_COUNT] = kept.sums
    cells[BIN_COUNT, W:Q] /= counts[COUNT]
    cells[BIN_COUNT, Q:JUMP] = kept.q
    counts[FILLED] = min(counts[FILLED] + 1, BIN_COUNT + 1)
    if counts[FILLED] <= BIN_COUNT:
        return NO_HYPOTHESIS, 0.0
    off = _angle(cells[0, W:M], cells[BIN_COUNT, W:M])
    if off <= _limit(cells):
        counts[OVER] = 0
        return NO_HYPOTHESIS, 0.0
    counts[OVER] += 1
    if counts[OVER] < CONFIRM_BINS:
        return NO_HYPOTHESIS, 0.0
    return _isolate(cells, off), off


@compiled
def _limit(cells: Vector) -> float:
    """How far the field may be off after this much of a turn, rad."""
    turn = bend = 0.0
    now = cells[BIN_COUNT]
    for i in range(BIN_COUNT):
        dot = 0.0
        for j in range(4):
            dot += now[Q + j] * cells[i, Q + j]
        turn = max(turn, 2.0 * atan2(sqrt(max(1.0 - dot * dot, 0.0)), abs(dot)))
        bend = max(bend, _angle(now[M:NORM], cells[i, M:NORM]))
    return LEAST_RAD + min(TURN_SHARE * min(turn, FIELD_PER_TURN * bend), MOST_RAD)


@compiled
def _isolate(cells: Vector, off: float) -> int:
    """Who is at fault if the field is off by so many rad."""
    before, now = cells[0, NORM], cells[BIN_COUNT, NORM]
    jump = second = 0.0
    for i in range(1, BIN_COUNT + 1):
        second = max(second, cells[i, SECOND], min(jump, cells[i, JUMP]))
        jump = max(jump, cells[i, JUMP])
    # A vehicle that tumbles jumps at every sample, a field that was falsified once.
    once = jump >= max(JUMP_SHARE * off, JUMP_RAD) and second < 0.5 * jump
    if once or abs(now - before) > SIZE_SHARE * before:
        return FIELD
    return RATES if off > GYRO_RAD else EITHER
