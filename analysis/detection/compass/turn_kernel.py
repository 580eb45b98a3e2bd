"""Compares the turns of compass and gyro, compiled; needs neither attitude nor filter.

The integrated gyro rates transform the measured field into a frame that does not rotate; there the
field is constant while both sensors are healthy. Its means over half a second are compared with
those of four seconds before. A poorly calibrated compass errs more the further it has turned, which
the limit allows for. The smaller turn of the two sets it: the larger may be the fault's.
"""

from math import atan2, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import IMU, IMU_ID, MAG, NEVER_US
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    quaternion_of_rotation,
    rotate_in_place,
    rotation_matrix,
)

NO_HYPOTHESIS, FIELD, RATES, EITHER = range(4)  # the faulty sensor
BIN_US, BIN_COUNT = 500_000, 8
# longest gap of the gyro, and between two fields that may show a jump
GAP_US, STEP_US = 100_000, 150_000
STEP_RAD = 0.1  # larger turns between two gyro samples are not integrated well
# At longer intervals vibration aliases to a slow turn; it is assumed if rates change by more.
SPARSE_GYRO_US, SHAKING_RPS = 30_000, 0.1
# Limit: LEAST_RAD + TURN_SHARE * turn, the latter at most MOST_RAD; a poor calibration errs with
# the turn. No false alarm on the 70 flights of docs/watches.md.
LEAST_RAD, TURN_SHARE, MOST_RAD = 0.08, 0.3, 0.35
FIELD_PER_TURN = 3.0  # a turn about an axis near the field changes its direction less: 19 degrees
CONFIRM_BINS = 2  # bins in a row
SIZE_SHARE = 0.1  # largest change of a healthy field's size
# step of the field that no vehicle turns in 0.15 s; and its share of the difference
JUMP_RAD, JUMP_SHARE = 0.15, 0.7
# A faulty compass would not turn so far without a change of size: it is the gyro.
GYRO_RAD = 0.6

GYRO, FIELD_US, BIN_NUMBER = range(3)  # stamps
FILLED, OVER, COUNT = range(3)
# Columns of a bin: field in both frames and its size, attitude, the two largest jumps
W, M, NORM, Q, JUMP, SECOND, WIDE = 0, 3, 6, 7, 11, 12, 13


class TurnState(NamedTuple):
    """`q` (4,) body to the frame; `rates` (3,) the newest; `field` (2, 3) the newest, in the frame
    and in the body; `stamps` and `counts` (3,); `bins` (1 + BIN_COUNT, WIDE), oldest first, and
    `sums` (WIDE,) of the one that is being filled. `track_turns` changes them."""

    q: Vector
    rates: Vector
    field: Vector
    stamps: NDArray[np.int64]
    counts: NDArray[np.int64]
    bins: Vector
    sums: Vector


def new_turns() -> TurnState:
    """No sample has come yet."""
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
    kind: NDArray[np.int64], t_us: NDArray[np.int64], values: Vector, state: TurnState
) -> tuple[NDArray[np.int64], Vector]:
    """The faulty sensor (n,) where a result is due, and the difference in rad (n,)."""
    faulty, difference = np.zeros(len(kind), np.int64), np.zeros(len(kind))
    for i in range(len(kind)):
        if kind[i] == IMU and values[i, IMU_ID] < 0.5:
            _add_gyro(t_us[i], values[i], state)
        elif kind[i] == MAG:
            faulty[i], difference[i] = _add_field(t_us[i], values[i], state)
    return faulty, difference


@compiled
def _add_gyro(t_us: int, rates: Vector, state: TurnState) -> None:
    """Integrate the gyro up to a sample."""
    elapsed_us = t_us - state.stamps[GYRO]
    known = state.stamps[GYRO] != NEVER_US and 0 <= elapsed_us <= GAP_US
    if not known or not np.isfinite(rates[0] + rates[1] + rates[2]):
        _restart(state)
    elif elapsed_us > 0:
        half_s = 0.5e-6 * elapsed_us
        x, y, z = [half_s * (rates[i] + state.rates[i]) for i in range(3)]
        if x * x + y * y + z * z > STEP_RAD**2 or (
            elapsed_us > SPARSE_GYRO_US and _change_sq(rates, state.rates) > SHAKING_RPS**2
        ):
            _restart(state)
        rotate_in_place(state.q, quaternion_of_rotation(x, y, z))
    state.stamps[GYRO] = t_us
    for i in range(3):
        state.rates[i] = rates[i] if np.isfinite(rates[i]) else 0.0


@compiled
def _change_sq(rates: Vector, oldest: Vector) -> float:
    total = 0.0
    for i in range(3):
        total += (rates[i] - oldest[i]) ** 2
    return total


@compiled
def _restart(state: TurnState) -> None:
    """Discard the past, part of which is missing."""
    state.counts[:] = 0
    state.sums[:] = 0.0


@compiled
def _add_field(t_us: int, field: Vector, state: TurnState) -> tuple[int, float]:
    """Add a field sample; the faulty sensor if it ends a bin."""
    m = field[:3].copy()
    size = sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
    repeated = m[0] == state.field[1, 0] and m[1] == state.field[1, 1] and m[2] == state.field[1, 2]
    # A repeated field does not show that the vehicle is at rest.
    if not 0.0 < size < np.inf or repeated:
        return NO_HYPOTHESIS, 0.0
    if state.stamps[GYRO] == NEVER_US or abs(t_us - state.stamps[GYRO]) > GAP_US:
        _restart(state)
        return NO_HYPOTHESIS, 0.0
    faulty, difference = NO_HYPOTHESIS, 0.0
    cell = t_us // BIN_US
    if cell != state.stamps[BIN_NUMBER]:
        if cell == state.stamps[BIN_NUMBER] + 1 and state.counts[COUNT] > 1:
            faulty, difference = _test_bins(state)
        else:
            _restart(state)
        state.stamps[BIN_NUMBER] = cell
        state.counts[COUNT] = 0
        state.sums[:] = 0.0
    w = np.dot(rotation_matrix(state.q), m)
    if 0 < t_us - state.stamps[FIELD_US] <= STEP_US:
        jump = min(_angle(w, state.field[0]), _angle(m, state.field[1]))
        state.sums[SECOND] = max(state.sums[SECOND], min(jump, state.sums[JUMP]))
        state.sums[JUMP] = max(state.sums[JUMP], jump)
    state.field[0], state.field[1], state.stamps[FIELD_US] = w, m, t_us
    state.counts[COUNT] += 1
    state.sums[W : W + 3] += w
    state.sums[M:NORM] += m
    state.sums[NORM] += size
    return faulty, difference


@compiled
def _angle(a: Vector, b: Vector) -> float:
    """The angle between two directions (3,), rad."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return atan2(sqrt(x * x + y * y + z * z), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def _test_bins(state: TurnState) -> tuple[int, float]:
    """Close the bin; the faulty sensor, and the difference in rad."""
    bins, counts = state.bins, state.counts
    for i in range(BIN_COUNT):
        bins[i] = bins[i + 1]
    bins[BIN_COUNT] = state.sums
    bins[BIN_COUNT, W:Q] /= counts[COUNT]
    bins[BIN_COUNT, Q:JUMP] = state.q
    counts[FILLED] = min(counts[FILLED] + 1, BIN_COUNT + 1)
    if counts[FILLED] <= BIN_COUNT:
        return NO_HYPOTHESIS, 0.0
    difference = _angle(bins[0, W:M], bins[BIN_COUNT, W:M])
    if difference <= _limit(bins):
        counts[OVER] = 0
        return NO_HYPOTHESIS, 0.0
    counts[OVER] += 1
    if counts[OVER] < CONFIRM_BINS:
        return NO_HYPOTHESIS, 0.0
    return _isolate(bins, difference), difference


@compiled
def _limit(bins: Vector) -> float:
    """The largest difference of a healthy field after this turn, rad."""
    turn = field_turn = 0.0
    newest = bins[BIN_COUNT]
    for i in range(BIN_COUNT):
        dot = 0.0
        for j in range(4):
            dot += newest[Q + j] * bins[i, Q + j]
        turn = max(turn, 2.0 * atan2(sqrt(max(1.0 - dot * dot, 0.0)), abs(dot)))
        field_turn = max(field_turn, _angle(newest[M:NORM], bins[i, M:NORM]))
    return LEAST_RAD + min(TURN_SHARE * min(turn, FIELD_PER_TURN * field_turn), MOST_RAD)


@compiled
def _isolate(bins: Vector, difference: float) -> int:
    """The faulty sensor for a difference in rad."""
    oldest, newest = bins[0, NORM], bins[BIN_COUNT, NORM]
    jump = second = 0.0
    for i in range(1, BIN_COUNT + 1):
        second = max(second, bins[i, SECOND], min(jump, bins[i, JUMP]))
        jump = max(jump, bins[i, JUMP])
    # In a tumble every sample jumps; a field that is falsified jumps once.
    single = jump >= max(JUMP_SHARE * difference, JUMP_RAD) and second < 0.5 * jump
    if single or abs(newest - oldest) > SIZE_SHARE * oldest:
        return FIELD
    return RATES if difference > GYRO_RAD else EITHER
