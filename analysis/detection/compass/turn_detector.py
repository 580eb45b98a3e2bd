"""Detects compass and gyro that turn differently, without filter or attitude.

A gyro bias about the vertical turns the heading and nothing else: neither the ranges of a hovering
vehicle nor the size of the field show it. In the frame of the integrated gyro the field is constant
(docs/watches.md, "Compass and gyro"). The smaller turn of the two sets the limit: the larger may be
the fault's.
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from analysis.detection.compass.compass_samples import (
    ZERO,
    Axis,
    add,
    angle_of,
    field_alarms,
)
from analysis.detection.detector_registry import BlockDetector, RowResults
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import NEVER_US, Block
from mavproxy_fault.numerics.rotations.one_rotation import rotate_quaternion, rotate_to_body

# Four seconds: with half as many bins `gyro-bias` is found 2.5 s later, with twice as many
# `mag-offset` is missed here (presets, benchmarks/preset_table.py).
BIN_US, BIN_COUNT = 500_000, 8
# Longest gaps, one lost sample allowed: of a gyro at 20 Hz, and of fields at 10 Hz that may jump.
GAP_US, STEP_US = 100_000, 150_000
# At longer intervals vibration aliases to a slow turn; it is assumed if rates change by more.
SPARSE_GYRO_US, SHAKING_RPS = 30_000, 0.1
# Limit: LEAST_RAD + TURN_SHARE * turn, the latter at most MOST_RAD; a poor calibration errs with
# the turn. No false alarm on the 70 flights of docs/watches.md.
LEAST_RAD, TURN_SHARE, MOST_RAD = 0.08, 0.3, 0.35
FIELD_PER_TURN = 3.0  # a turn about an axis near the field changes its direction less: 19 degrees
CONFIRM_BINS = 2  # bins in a row: one may hold a lost sample
SIZE_SHARE = 0.1  # largest change of a healthy field's size: LevelDetector's 0.05 of 0.5 gauss
# step of the field that no vehicle turns in 0.15 s; and its share of the difference
JUMP_RAD, JUMP_SHARE = 0.15, 0.7
# A faulty compass would not turn so far without a change of size: it is the gyro.
GYRO_RAD = 0.6


@dataclass(slots=True)
class _FieldBin:
    """Sums of half a second: the field in the frame and in the body, and its size."""

    count: int = 0
    in_frame: Axis = ZERO
    in_body: Axis = ZERO
    size: float = 0.0
    jump: float = 0.0  # the two largest
    second: float = 0.0
    q: tuple[float, ...] = ()  # the attitude in the frame at its end


@dataclass(slots=True)
class TurnState:
    """The newest samples, the bins before, oldest first, and the one that is being filled."""

    q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # body to the frame
    rates: Axis = ZERO
    gyro_us: int = NEVER_US
    in_frame: Axis = ZERO
    in_body: Axis = ZERO
    field_us: int = NEVER_US
    number: int = NEVER_US  # of the open bin
    open: _FieldBin = field(default_factory=_FieldBin)
    bins: deque[_FieldBin] = field(default_factory=lambda: deque(maxlen=BIN_COUNT + 1))
    over: int = 0  # bins in a row above the limit

    def restart(self) -> None:
        """Discard the past, part of which is missing."""
        self.over, self.open = 0, _FieldBin()
        self.bins.clear()


class TurnDetector(BlockDetector, frozen=True):
    """Compares the turns over four seconds."""

    channels: ClassVar = frozenset({"imu", "mag"})
    state: ClassVar = TurnState

    def step(self, block: Block, state: TurnState) -> tuple[RowResults, TurnState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        return field_alarms(block, state, _add_gyro, _add_field), state


def turn_alarm(
    t_us: int, turned_rad: float, for_s: int, field_differs: bool = False
) -> SensorDecision:
    """The alarm for a difference of the turns in so many seconds."""
    either = not field_differs and turned_rad <= GYRO_RAD
    return pattern_alarm(
        t_us,
        "mag" if field_differs else "imu",
        f"compass and gyro turned {np.degrees(turned_rad):.0f} degrees apart in {for_s} s",
        suspect="imu-or-mag" if either else "",
        isolated=not either,
    )


def _add_gyro(t_us: int, rates: Axis, state: TurnState) -> None:
    """Integrate the gyro up to a sample."""
    elapsed_us = t_us - state.gyro_us
    finite = all(map(math.isfinite, rates))
    if not 0 <= elapsed_us <= GAP_US or not finite:
        state.restart()
    elif elapsed_us > 0:
        half_s = 0.5e-6 * elapsed_us
        turn = add((half_s * rates[0], half_s * rates[1], half_s * rates[2]), state.rates, half_s)
        if elapsed_us > SPARSE_GYRO_US and math.dist(rates, state.rates) > SHAKING_RPS:
            state.restart()
        state.q = rotate_quaternion(state.q, turn)
    state.gyro_us, state.rates = t_us, rates if finite else ZERO


def _add_field(t_us: int, m: Axis, state: TurnState) -> SensorDecision | None:
    """Add a field sample; the alarm, if it ends a bin that shows a fault."""
    size = math.hypot(*m)
    # A repeated field does not show that the vehicle is at rest.
    if not 0.0 < size < math.inf or m == state.in_body:
        return None
    if abs(t_us - state.gyro_us) > GAP_US:
        state.restart()
        return None
    alarm = None
    number = t_us // BIN_US
    if number != state.number:
        if number == state.number + 1 and state.open.count > 1:
            alarm = _test_bins(t_us, state)
        else:
            state.restart()
        state.number, state.open = number, _FieldBin()
    cell = state.open
    w, x, y, z = state.q
    in_frame = rotate_to_body((w, -x, -y, -z), m)
    if 0 < t_us - state.field_us <= STEP_US:
        jump = min(angle_of(in_frame, state.in_frame), angle_of(m, state.in_body))
        cell.second = max(cell.second, min(jump, cell.jump))
        cell.jump = max(cell.jump, jump)
    state.in_frame, state.in_body, state.field_us = in_frame, m, t_us
    cell.count += 1
    cell.in_frame, cell.in_body = add(cell.in_frame, in_frame), add(cell.in_body, m)
    cell.size += size
    return alarm


def _test_bins(t_us: int, state: TurnState) -> SensorDecision | None:
    """Close the bin and compare it with the oldest."""
    newest = replace(state.open, q=state.q, size=state.open.size / state.open.count)
    state.bins.append(newest)
    if len(state.bins) <= BIN_COUNT:
        return None
    oldest = state.bins[0]
    difference = angle_of(oldest.in_frame, newest.in_frame)
    if difference <= _limit(state.bins):
        state.over = 0
        return None
    state.over += 1
    if state.over < CONFIRM_BINS:
        return None
    # In a tumble every sample jumps; a field that is falsified jumps once.
    jumps = [jump for cell in list(state.bins)[1:] for jump in (cell.jump, cell.second)]
    second, jump = sorted(jumps)[-2:]
    single = jump >= max(JUMP_SHARE * difference, JUMP_RAD) and second < 0.5 * jump
    resized = abs(newest.size - oldest.size) > SIZE_SHARE * oldest.size
    return turn_alarm(t_us, difference, 4, field_differs=single or resized)


def _limit(bins: deque[_FieldBin]) -> float:
    """The largest difference of a healthy field after this turn, rad."""
    turn = field_turn = 0.0
    *before, newest = bins
    for cell in before:
        cosine = sum(a * b for a, b in zip(newest.q, cell.q, strict=True))
        sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
        turn = max(turn, 2.0 * math.atan2(sine, abs(cosine)))
        field_turn = max(field_turn, angle_of(newest.in_body, cell.in_body))
    return LEAST_RAD + min(TURN_SHARE * min(turn, FIELD_PER_TURN * field_turn), MOST_RAD)
