"""Compass and gyro that on average turn otherwise, compiled; for gyros that are logged slowly, too.

A field of direction u that does not turn moves in the body by du = -w x u dt, w the rates. Between
two samples of the compass the gyro turns the body by a small angle a, so that

    r = u_2 - u_1 + a x (u_1 + u_2) / 2

is noise if both are sound. What shakes cancels in its sum, however seldom it was sampled; a gyro's
bias does not. The sum of five seconds, as a rate, is held against its own past. A compass that is
falsified at once makes one large r that stays. `turn_kernel` tells within a second or two what it
can, but has to integrate, and cannot where a slow gyro is shaken.
"""

from math import sqrt
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.compass.turn_detector import turn_alarm
from analysis.detection.compass.turn_kernel import (
    EITHER,
    FIELD,
    GYRO_RAD,
    JUMP_RAD,
    JUMP_SHARE,
    NO_HYPOTHESIS,
    RATES,
    SIZE_SHARE,
    STEP_US,
)
from analysis.detection.detector_registry import BlockDetector
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import IMU, IMU_ID, MAG, Block
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

BIN_US, BIN_COUNT = 1_000_000, 5
GAP_US = 1_000_000  # between two fields that are not the same
INTERVALS, LONGEST_US = 2.5, 350_000  # of the gyro: it is not known how it shook in a longer gap
MOST_RAD = 0.4  # between two fields: what turns further is no small angle
LEAST_RPS, USUAL_FACTOR, TURN_SHARE = (
    0.08,
    4.0,
    0.2,
)  # limit: the most of LEAST and USUAL of the past, + a turn
BIN_SHARE = (
    0.4  # of the mean that every cell has to show, the same way: a field that jumps does so once
)
LEARNED_BINS = 10
MEMORY = 0.05  # of a window in what is usual
PEAK_FACTOR, PEAK_S, LEARNED_S = (
    4.0,
    30.0,
    10.0,
)  # of the largest r of late, of what memory, known after
JUMP_CONFIRM_US, JUMP_REPORTED_US = (
    500_000,
    4_000_000,
)  # until a jump counts; for how long it is told
NEVER_US = -(1 << 62)

GYRO, FIELD_US, BIN_BEGIN_US, JUMPED, FOUND = range(
    5
)  # stamps, the last of a jump and of one that stayed
RATE, WINDOWS, PEAK, KNOWN_S, INTERVAL_US = range(5)  # of what is usual
R, A, TIME, NORM, WIDE = 0, 3, 6, 7, 8  # columns of a cell: sums of r, a and time; the newest size


class MeanTurnState(NamedTuple):
    """`stamps` (5,); `rates` (3,) the newest, `angle` (3,) turned since the newest `field` (3,)
    that was not the one before, of direction `u` (3,); `cells` (CELLS, WIDE), the newest last;
    `usual` (5,): the rate and of how many windows, the largest r of late and for how long it is
    known, the gyro's interval; `jump` (2, 3): r of a jump, and all since."""

    stamps: NDArray[np.int64]
    rates: Vector
    angle: Vector
    field: Vector
    u: Vector
    cells: Vector
    usual: Vector
    jump: Vector


def new_mean_turns() -> MeanTurnState:
    """Nothing came yet."""
    return MeanTurnState(
        np.full(5, NEVER_US),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros((BIN_COUNT, WIDE)),
        np.zeros(5),
        np.zeros((2, 3)),
    )


@compiled
def track_mean_turns(
    kind: NDArray[np.int64], t_us: NDArray[np.int64], values: Vector, kept: MeanTurnState
) -> tuple[NDArray[np.int64], Vector]:
    """Who (n,) is at fault where that is to be told, NOBODY elsewhere, and by how many rad (n,)."""
    who, off = np.zeros(len(kind), np.int64), np.zeros(len(kind))
    for i in range(len(kind)):
        if kind[i] == IMU and values[i, IMU_ID] < 0.5:
            _add_gyro(t_us[i], values[i, :3], kept)
        elif kind[i] == MAG:
            who[i], off[i] = _add_field(t_us[i], values[i, :3], kept)
    return who, off


@compiled
def _add_gyro(t_us: int, rates: Vector, kept: MeanTurnState) -> None:
    """Add a sample of the gyro to the angle."""
    elapsed_us, usual = t_us - kept.stamps[GYRO], kept.usual
    most_us = min(INTERVALS * usual[INTERVAL_US], LONGEST_US)
    if 0 <= elapsed_us <= LONGEST_US:
        share = MEMORY if usual[INTERVAL_US] > 0.0 else 1.0
        usual[INTERVAL_US] += share * (elapsed_us - usual[INTERVAL_US])
    if not np.isfinite(rates).all() or not 0 <= elapsed_us <= most_us:
        kept.stamps[FIELD_US] = NEVER_US
    else:
        kept.angle[:] += 0.5e-6 * elapsed_us * (rates + kept.rates)
    kept.stamps[GYRO] = t_us
    kept.rates[:] = rates


@compiled
def _add_field(t_us: int, field: Vector, kept: MeanTurnState) -> tuple[int, float]:
    """Add a sample of the field; who is at fault, and by how many rad."""
    size = sqrt(_square(field))
    repeated = (field == kept.field).all()
    kept.field[:] = field
    # One that is only repeated does not tell that the vehicle stands.
    if not 0.0 < size < np.inf or repeated:
        return NO_HYPOTHESIS, 0.0
    u, who, off = field / size, NO_HYPOTHESIS, 0.0
    since_us, cells, angle, stamps = (
        t_us - kept.stamps[FIELD_US],
        kept.cells,
        kept.angle,
        kept.stamps,
    )
    if stamps[FIELD_US] == NEVER_US or not 0 < since_us <= GAP_US or _square(angle) > MOST_RAD**2:
        cells[:], stamps[BIN_BEGIN_US], stamps[JUMPED] = 0.0, t_us, NEVER_US
    else:
        if t_us - stamps[BIN_BEGIN_US] >= BIN_US:
            off = _test_bins(kept)
            if off > 0.0:
                who = RATES if off > GYRO_RAD else EITHER
            cells[:-1] = cells[1:].copy()
            cells[-1], stamps[BIN_BEGIN_US] = 0.0, t_us
        mean, r = 0.5 * (u + kept.u), u - kept.u
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            r[i] += angle[j] * mean[k] - angle[k] * mean[j]
        now = cells[-1]
        now[R : R + 3] += r
        now[A : A + 3] += angle
        now[TIME] += 1e-6 * since_us
        now[NORM] = size
        if _field_jumped(t_us, r, 1e-6 * since_us, kept):
            who, off = FIELD, sqrt(_square(kept.jump[0]))
    kept.u[:], kept.angle[:], stamps[FIELD_US] = u, 0.0, t_us
    return who, off


@compiled
def _square(vector: Vector) -> float:
    square: float = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
    return square


@compiled
def _field_jumped(t_us: int, r: Vector, since_s: float, kept: MeanTurnState) -> bool:
    """Whether there is a jump of the field to tell: one that stayed, for a while."""
    usual, jump, stamps, size = kept.usual, kept.jump, kept.stamps, sqrt(_square(r))
    if stamps[JUMPED] != NEVER_US:
        jump[1] += r
        if t_us - stamps[JUMPED] < JUMP_CONFIRM_US:
            return False
        stays: bool = jump[0] @ jump[1] >= JUMP_SHARE * _square(jump[0])
        stamps[FOUND], stamps[JUMPED] = t_us if stays else NEVER_US, NEVER_US
        return stays
    most = max(JUMP_RAD, PEAK_FACTOR * usual[PEAK], sqrt(_square(kept.angle)))
    if usual[KNOWN_S] > LEARNED_S and size > most and since_s <= STEP_US * 1e-6:
        jump[0], jump[1], stamps[JUMPED] = r, r, t_us
        return False
    usual[KNOWN_S] += since_s
    usual[PEAK] = max(min(size, JUMP_RAD), usual[PEAK] * (1.0 - since_s / PEAK_S))
    lasts: bool = stamps[BIN_BEGIN_US] == t_us and t_us - stamps[FOUND] < JUMP_REPORTED_US
    return lasts


@compiled
def _test_bins(kept: MeanTurnState) -> float:
    """By how many rad compass and gyro turned apart in the cells, if by more than they may."""
    cells, usual = kept.cells, kept.usual
    if cells[0, TIME] == 0.0:
        return 0.0
    seconds, off_sq, turn_sq = cells[:, TIME].sum(), 0.0, 0.0
    r = np.zeros(3)
    for i in range(3):
        r[i] = cells[:, R + i].sum()
        off_sq += r[i] ** 2
        turn_sq += cells[:, A + i].sum() ** 2
    off, turn = sqrt(off_sq), sqrt(turn_sq)
    rate = off / seconds
    steady = abs(cells[-1, NORM] - cells[0, NORM]) <= SIZE_SHARE * cells[0, NORM]
    for cell in cells:
        along = cell[R] * r[0] + cell[R + 1] * r[1] + cell[R + 2] * r[2]
        steady &= along / max(off, 1e-9) >= BIN_SHARE * rate * cell[TIME]
    limit = max(LEAST_RPS, USUAL_FACTOR * usual[RATE]) + TURN_SHARE * turn / seconds
    if steady and rate > limit and usual[WINDOWS] >= LEARNED_BINS:
        return off
    usual[WINDOWS] += 1.0
    usual[RATE] += max(MEMORY, 1.0 / usual[WINDOWS]) * (min(rate, LEAST_RPS) - usual[RATE])
    return 0.0


class MeanTurnDetector(BlockDetector, frozen=True):
    """A step of the pipeline."""

    channels: ClassVar = frozenset({"imu", "mag"})

    def new_state(self) -> MeanTurnState:
        """Nothing came yet."""
        return new_mean_turns()

    def step(
        self, block: Block, state: MeanTurnState
    ) -> tuple[list[tuple[int, SensorDecision]], MeanTurnState]:
        """Who turns otherwise, by the row that shows it, and the next state.

        The state is changed in place.
        """
        who, off = track_mean_turns(block.kind, block.t_us, block.values, state)
        return [
            (row, _result(int(block.t_us[row]), int(who[row]), float(off[row])))
            for row in np.flatnonzero(who).tolist()
        ], state


def _result(t_us: int, who: int, off_rad: float) -> SensorDecision:
    if who == FIELD:
        reason = f"the field jumped by {np.degrees(off_rad):.0f} degrees, the gyro did not turn"
        return pattern_alarm(t_us, "mag", reason)
    return turn_alarm(t_us, who, off_rad, BIN_COUNT)
