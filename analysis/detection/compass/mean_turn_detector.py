"""Compares the mean turns of compass and gyro, compiled; works for slowly logged gyros too.

A field of direction u that does not turn itself moves in the body by du = -w x u dt, w the rates.
Between two compass samples the gyro turns the body by a small angle a, so that

    r = u_2 - u_1 + a x (u_1 + u_2) / 2

is noise if both are healthy. Vibration cancels in its sum, however sparsely it was sampled; a gyro
bias does not. The sum of five seconds, as a rate, is compared with its own past. A compass that is
falsified at once makes a single large r that persists. `turn_kernel` detects what it can within a
second or two, but has to integrate, which fails for a slowly logged gyro under vibration.
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
from analysis.samples.block import IMU, IMU_ID, MAG, NEVER_US, Block
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

BIN_US, BIN_COUNT = 1_000_000, 5
GAP_US = 1_000_000  # between two different fields
# gyro gaps without a known rate: in usual intervals, and at most
INTERVALS, LONGEST_US = 2.5, 350_000
MOST_RAD = 0.4  # between two fields: larger angles are not small, r errs by a^2 / 2 = 8 %
# Limit: the larger of LEAST_RPS and USUAL_FACTOR times the usual rate, plus a share of the turn.
# 15 flights of set A (docs/verdicts.md) have at most 0.03 rad/s without a fault.
LEAST_RPS, USUAL_FACTOR, TURN_SHARE = 0.08, 4.0, 0.2
BIN_SHARE = 0.4  # of the mean rate that every bin must show: a field that jumps does so in one bin
LEARNED_BINS = 10  # windows before the first test, chosen
MEMORY = 0.05  # weight of a window in the usual rate: 20 windows
# A jump exceeds the largest recent r by this factor; its memory; and when it is known. Chosen.
PEAK_FACTOR, PEAK_S, LEARNED_S = 4.0, 30.0, 10.0
JUMP_CONFIRM_US, JUMP_REPORTED_US = 500_000, 4_000_000  # until and while it is reported, chosen

# Stamps; the last two of a jump and of a confirmed one.
GYRO, FIELD_US, BIN_BEGIN_US, JUMPED, CONFIRMED = range(5)
RATE, WINDOWS, PEAK, KNOWN_S, INTERVAL_US = range(5)  # of `usual`
R, A, TIME, NORM, WIDE = 0, 3, 6, 7, 8  # columns of a bin: sums of r, a and time; the newest size


class MeanTurnState(NamedTuple):
    """`stamps` (5,); `rates` (3,) the newest, `angle` (3,) turned since the newest changed `field`
    (3,), whose direction is `u` (3,); `bins` (BIN_COUNT, WIDE), the newest last; `usual` (5,): the
    rate and the number of windows, the largest recent r and for how long it is known, the gyro's
    interval; `jump` (2, 3): r of a jump, and the sum of r since."""

    stamps: NDArray[np.int64]
    rates: Vector
    angle: Vector
    field: Vector
    u: Vector
    bins: Vector
    usual: Vector
    jump: Vector


def new_mean_turns() -> MeanTurnState:
    """No sample has come yet."""
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
    kind: NDArray[np.int64], t_us: NDArray[np.int64], values: Vector, state: MeanTurnState
) -> tuple[NDArray[np.int64], Vector]:
    """The faulty sensor (n,) where a result is due, and the difference in rad (n,)."""
    faulty, turned_rad = np.zeros(len(kind), np.int64), np.zeros(len(kind))
    for i in range(len(kind)):
        if kind[i] == IMU and values[i, IMU_ID] < 0.5:
            _add_gyro(t_us[i], values[i, :3], state)
        elif kind[i] == MAG:
            faulty[i], turned_rad[i] = _add_field(t_us[i], values[i, :3], state)
    return faulty, turned_rad


@compiled
def _add_gyro(t_us: int, rates: Vector, state: MeanTurnState) -> None:
    """Add a gyro sample to the angle."""
    elapsed_us, usual = t_us - state.stamps[GYRO], state.usual
    most_us = min(INTERVALS * usual[INTERVAL_US], LONGEST_US)
    if 0 <= elapsed_us <= LONGEST_US:
        share = MEMORY if usual[INTERVAL_US] > 0.0 else 1.0
        usual[INTERVAL_US] += share * (elapsed_us - usual[INTERVAL_US])
    if not np.isfinite(rates).all() or not 0 <= elapsed_us <= most_us:
        state.stamps[FIELD_US] = NEVER_US
    else:
        state.angle[:] += 0.5e-6 * elapsed_us * (rates + state.rates)
    state.stamps[GYRO] = t_us
    state.rates[:] = rates


@compiled
def _add_field(t_us: int, field: Vector, state: MeanTurnState) -> tuple[int, float]:
    """Add a field sample; the faulty sensor, and the difference in rad."""
    size = sqrt(_square(field))
    repeated = (field == state.field).all()
    state.field[:] = field
    # A repeated field does not show that the vehicle is at rest.
    if not 0.0 < size < np.inf or repeated:
        return NO_HYPOTHESIS, 0.0
    u, faulty, turned_rad = field / size, NO_HYPOTHESIS, 0.0
    since_us, bins, angle, stamps = (
        t_us - state.stamps[FIELD_US],
        state.bins,
        state.angle,
        state.stamps,
    )
    if stamps[FIELD_US] == NEVER_US or not 0 < since_us <= GAP_US or _square(angle) > MOST_RAD**2:
        bins[:], stamps[BIN_BEGIN_US], stamps[JUMPED] = 0.0, t_us, NEVER_US
    else:
        if t_us - stamps[BIN_BEGIN_US] >= BIN_US:
            turned_rad = _test_bins(state)
            if turned_rad > 0.0:
                faulty = RATES if turned_rad > GYRO_RAD else EITHER
            bins[:-1] = bins[1:].copy()
            bins[-1], stamps[BIN_BEGIN_US] = 0.0, t_us
        mean, r = 0.5 * (u + state.u), u - state.u
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            r[i] += angle[j] * mean[k] - angle[k] * mean[j]
        newest = bins[-1]
        newest[R : R + 3] += r
        newest[A : A + 3] += angle
        newest[TIME] += 1e-6 * since_us
        newest[NORM] = size
        if _field_jumped(t_us, r, 1e-6 * since_us, state):
            faulty, turned_rad = FIELD, sqrt(_square(state.jump[0]))
    state.u[:], state.angle[:], stamps[FIELD_US] = u, 0.0, t_us
    return faulty, turned_rad


@compiled
def _square(vector: Vector) -> float:
    square: float = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
    return square


@compiled
def _field_jumped(t_us: int, r: Vector, since_s: float, state: MeanTurnState) -> bool:
    """Whether a confirmed jump of the field is to be reported."""
    usual, jump, stamps, size = state.usual, state.jump, state.stamps, sqrt(_square(r))
    if stamps[JUMPED] != NEVER_US:
        jump[1] += r
        if t_us - stamps[JUMPED] < JUMP_CONFIRM_US:
            return False
        confirmed: bool = jump[0] @ jump[1] >= JUMP_SHARE * _square(jump[0])
        stamps[CONFIRMED], stamps[JUMPED] = t_us if confirmed else NEVER_US, NEVER_US
        return confirmed
    limit = max(JUMP_RAD, PEAK_FACTOR * usual[PEAK], sqrt(_square(state.angle)))
    if usual[KNOWN_S] > LEARNED_S and size > limit and since_s <= STEP_US * 1e-6:
        jump[0], jump[1], stamps[JUMPED] = r, r, t_us
        return False
    usual[KNOWN_S] += since_s
    usual[PEAK] = max(min(size, JUMP_RAD), usual[PEAK] * (1.0 - since_s / PEAK_S))
    continues: bool = stamps[BIN_BEGIN_US] == t_us and t_us - stamps[CONFIRMED] < JUMP_REPORTED_US
    return continues


@compiled
def _test_bins(state: MeanTurnState) -> float:
    """The difference of the turns in the bins in rad, if it exceeds the limit, else 0."""
    bins, usual = state.bins, state.usual
    if bins[0, TIME] == 0.0:
        return 0.0
    seconds, turned_sq, turn_sq = bins[:, TIME].sum(), 0.0, 0.0
    r = np.zeros(3)
    for i in range(3):
        r[i] = bins[:, R + i].sum()
        turned_sq += r[i] ** 2
        turn_sq += bins[:, A + i].sum() ** 2
    turned_rad, turn = sqrt(turned_sq), sqrt(turn_sq)
    rate = turned_rad / seconds
    steady = abs(bins[-1, NORM] - bins[0, NORM]) <= SIZE_SHARE * bins[0, NORM]
    for cell in bins:
        along = cell[R] * r[0] + cell[R + 1] * r[1] + cell[R + 2] * r[2]
        steady &= along / max(turned_rad, 1e-9) >= BIN_SHARE * rate * cell[TIME]
    limit = max(LEAST_RPS, USUAL_FACTOR * usual[RATE]) + TURN_SHARE * turn / seconds
    if steady and rate > limit and usual[WINDOWS] >= LEARNED_BINS:
        return turned_rad
    usual[WINDOWS] += 1.0
    usual[RATE] += max(MEMORY, 1.0 / usual[WINDOWS]) * (min(rate, LEAST_RPS) - usual[RATE])
    return 0.0


class MeanTurnDetector(BlockDetector, frozen=True):
    """Tests the sum of r over five seconds."""

    channels: ClassVar = frozenset({"imu", "mag"})

    def new_state(self) -> MeanTurnState:
        """No sample has come yet."""
        return new_mean_turns()

    def step(
        self, block: Block, state: MeanTurnState
    ) -> tuple[list[tuple[int, SensorDecision]], MeanTurnState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        faulty, turned_rad = track_mean_turns(block.kind, block.t_us, block.values, state)
        return [
            (row, _result(int(block.t_us[row]), int(faulty[row]), float(turned_rad[row])))
            for row in np.flatnonzero(faulty).tolist()
        ], state


def _result(t_us: int, faulty: int, off_rad: float) -> SensorDecision:
    if faulty == FIELD:
        reason = f"the field jumped by {np.degrees(off_rad):.0f} degrees, the gyro did not turn"
        return pattern_alarm(t_us, "mag", reason)
    return turn_alarm(t_us, faulty, off_rad, BIN_COUNT)
