"""Compares the mean turns of compass and gyro, works for slowly logged gyros too.

Between two compass samples the residual r of the field's direction, turned by the gyro's small
angle, is noise if both are healthy, and vibration cancels in its sum (docs/watches.md, "Compass and
gyro"). A compass that is falsified at once makes a single large r that persists.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import ClassVar

from analysis.detection.compass.compass_samples import ZERO, Axis, add, cross, dot, field_alarms
from analysis.detection.compass.turn_detector import (
    JUMP_RAD,
    JUMP_SHARE,
    STEP_US,
    turn_alarm,
)
from analysis.detection.detector_registry import BlockDetector, RowResults
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import NEVER_US, Block

# LEAST_RPS over these 5 s is 23 degrees: more than the 20 by which PX4 accepts a compass to be off
# (EKF2_MAG_CHK_INC). Two different fields are at most one bin apart.
BIN_US, BIN_COUNT = 1_000_000, 5
# Gaps of the gyro that are bridged: one lost sample, in usual intervals, and at most what a
# vehicle turns by MOST_RAD at 1 rad/s.
INTERVALS, LONGEST_US = 2.5, 350_000
MOST_RAD = 0.4  # between two fields: larger angles are not small, r errs by a^2 / 2 = 8 %
# Limit: the larger of LEAST_RPS and USUAL_FACTOR times the usual rate, plus a share of the turn.
# 15 flights of set A (docs/verdicts.md) have at most 0.03 rad/s without a fault.
LEAST_RPS, USUAL_FACTOR, TURN_SHARE = 0.08, 4.0, 0.2
BIN_SHARE = 0.4  # of the mean rate that every bin must show: a field that jumps does so in one bin
LEARNED_BINS = 10  # windows before the first test: the usual rate is then known to a third
MEMORY = 0.05  # weight of a window in the usual rate: 20 windows
# A jump exceeds the largest recent r by this factor; its memory; and when it is known. With half of
# the factor the end of `mag-offset` is a jump, too (benchmarks/preset_table.py).
PEAK_FACTOR, PEAK_S, LEARNED_S = 4.0, 30.0, 10.0
JUMP_CONFIRM_US = 500_000  # r of a single spike has cancelled by then
JUMP_REPORTED_US = 4_000_000  # as long as TurnDetector compares with the time before


@dataclass(slots=True)
class _TurnBin:
    """Sums of r and of the gyro's angle over a second."""

    r: Axis = ZERO
    angle: Axis = ZERO
    seconds: float = 0.0


@dataclass(slots=True)
class MeanTurnState:
    """The newest samples, the bins, the newest last, and what is usual."""

    gyro_us: int = NEVER_US
    rates: Axis = ZERO
    interval_us: float = 0.0  # of the gyro
    angle: Axis = ZERO  # turned since the newest changed field
    newest: Axis = ZERO
    field_us: int = NEVER_US
    u: Axis = ZERO  # its direction
    bin_begin_us: int = NEVER_US
    bins: deque[_TurnBin] = field(default_factory=lambda: deque(maxlen=BIN_COUNT))
    rate: float = 0.0  # the usual one, and of so many windows
    windows: int = 0
    peak: float = 0.0  # the largest recent r, and for how long it is known
    known_s: float = 0.0
    jump: Axis = ZERO  # r of a jump, and the sum of r since
    jump_sum: Axis = ZERO
    jumped_us: int = NEVER_US
    confirmed_us: int = NEVER_US


class MeanTurnDetector(BlockDetector, frozen=True):
    """Tests the sum of r over five seconds."""

    channels: ClassVar = frozenset({"imu", "mag"})
    state: ClassVar = MeanTurnState

    def step(self, block: Block, state: MeanTurnState) -> tuple[RowResults, MeanTurnState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        return field_alarms(block, state, _add_gyro, _add_field), state


def _add_gyro(t_us: int, rates: Axis, state: MeanTurnState) -> None:
    """Add a gyro sample to the angle."""
    elapsed_us = t_us - state.gyro_us
    if 0 <= elapsed_us <= LONGEST_US:
        share = MEMORY if state.interval_us > 0.0 else 1.0
        state.interval_us += share * (elapsed_us - state.interval_us)
    if not all(map(math.isfinite, rates)) or not 0 <= elapsed_us <= INTERVALS * state.interval_us:
        state.field_us = NEVER_US
    else:
        state.angle = add(state.angle, add(rates, state.rates), 0.5e-6 * elapsed_us)
    state.gyro_us, state.rates = t_us, rates


def _add_field(t_us: int, m: Axis, state: MeanTurnState) -> SensorDecision | None:
    """Add a field sample; the alarm that it raises."""
    size = math.hypot(*m)
    repeated, state.newest = m == state.newest, m
    # A repeated field does not show that the vehicle is at rest.
    if not 0.0 < size < math.inf or repeated:
        return None
    u, alarm, since_us = add(ZERO, m, 1.0 / size), None, t_us - state.field_us
    if not 0 < since_us <= BIN_US or math.hypot(*state.angle) > MOST_RAD:
        state.bins.clear()
        state.bins.append(_TurnBin())
        state.bin_begin_us, state.jumped_us = t_us, NEVER_US
    else:
        if t_us - state.bin_begin_us >= BIN_US:
            turned_rad = _test_bins(state)
            if turned_rad > 0.0:
                alarm = turn_alarm(t_us, turned_rad, BIN_COUNT)
            state.bins.append(_TurnBin())
            state.bin_begin_us = t_us
        r = add(add(u, state.u, -1.0), cross(state.angle, add(u, state.u)), 0.5)
        newest = state.bins[-1]
        newest.r, newest.angle = add(newest.r, r), add(newest.angle, state.angle)
        newest.seconds += 1e-6 * since_us
        if _field_jumped(t_us, r, 1e-6 * since_us, state):
            jumped_deg = math.degrees(math.hypot(*state.jump))
            reason = f"the field jumped by {jumped_deg:.0f} degrees, the gyro did not turn"
            alarm = pattern_alarm(t_us, "mag", reason)
    state.u, state.angle, state.field_us = u, ZERO, t_us
    return alarm


def _field_jumped(t_us: int, r: Axis, since_s: float, state: MeanTurnState) -> bool:
    """Whether a confirmed jump of the field is to be reported."""
    if state.jumped_us != NEVER_US:
        state.jump_sum = add(state.jump_sum, r)
        if t_us - state.jumped_us < JUMP_CONFIRM_US:
            return False
        confirmed = dot(state.jump, state.jump_sum) >= JUMP_SHARE * dot(state.jump, state.jump)
        state.confirmed_us, state.jumped_us = t_us if confirmed else NEVER_US, NEVER_US
        return confirmed
    size = math.hypot(*r)
    limit = max(JUMP_RAD, PEAK_FACTOR * state.peak, math.hypot(*state.angle))
    if state.known_s > LEARNED_S and size > limit and since_s <= STEP_US * 1e-6:
        state.jump, state.jump_sum, state.jumped_us = r, r, t_us
        return False
    state.known_s += since_s
    state.peak = max(min(size, JUMP_RAD), state.peak * (1.0 - since_s / PEAK_S))
    return state.bin_begin_us == t_us and t_us - state.confirmed_us < JUMP_REPORTED_US


def _test_bins(state: MeanTurnState) -> float:
    """The difference of the turns in the bins in rad, if it exceeds the limit, else 0."""
    bins = state.bins
    if len(bins) < BIN_COUNT or bins[0].seconds == 0.0:
        return 0.0
    seconds = sum(cell.seconds for cell in bins)
    r, angle = ZERO, ZERO
    for cell in bins:
        r, angle = add(r, cell.r), add(angle, cell.angle)
    turned_rad = math.hypot(*r)
    rate = turned_rad / seconds
    steady = all(
        dot(cell.r, r) / max(turned_rad, 1e-9) >= BIN_SHARE * rate * cell.seconds for cell in bins
    )
    limit = max(LEAST_RPS, USUAL_FACTOR * state.rate) + TURN_SHARE * math.hypot(*angle) / seconds
    if steady and rate > limit and state.windows >= LEARNED_BINS:
        return turned_rad
    state.windows += 1
    state.rate += max(MEMORY, 1.0 / state.windows) * (min(rate, LEAST_RPS) - state.rate)
    return 0.0
