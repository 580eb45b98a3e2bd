"""Samples to cells of a tenth of a second, compiled: mean motion, and what it came from.

The mean rates of two neighbouring cells differ by the angular acceleration, seen through a triangle
that rises over the first cell and falls over the second. Commands, rates and specific force are
averaged by the same triangle, so that all of them tell of the same time. Commands pass a lag first,
which motors and servos have.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import (
    AIRSPEED,
    AXES,
    COMMANDS,
    CONSTANT,
    DOWN,
    FORCE,
    FORWARD,
    FORWARD_BY_AIRSPEED,
    OUTPUT,
    RATE,
    TERMS,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

BIN_US = 100_000
NEVER_BIN = -(1 << 40)

# Of a cell's `clock`: its number, the newest sample's stamp, and whether a cell is before it
NUMBER, SAMPLE_US, HAS_PREVIOUS = range(3)
# Of `sums`: samples, their times in the cell, rates, specific force, lagged commands, airspeed;
# then the same weighted by the time in the cell, which rises from 0 to 1
COUNT, TIME, RATES, FORCES, LAGGED = 0, 1, 2, 5, 8
AIR = LAGGED + COMMANDS
WIDTH = AIR + 1
VALUE_MPS, UNTIL_US = range(2)  # of `air`
AIR_LASTS_US = 300_000  # an airspeed


class MotionBins(NamedTuple):
    """The cell that is being filled, and the one before; `add_imu_sample` changes them in place.

    `lags_s` (COMMANDS,) of the actuators; `clock` (3,) as named above; `commands` (2, COMMANDS):
    the newest, and behind their lags; `air` (2,): the newest airspeed, and until when it is; `sums`
    (2, 2, WIDTH): cell and the one before, plain and weighted. `terms` (TERMS,) and `motion`
    (AXES,) are those of the last two full cells; without an airspeed its term is 0.
    """

    lags_s: Vector
    clock: NDArray[np.int64]
    commands: Vector
    air: Vector
    sums: Vector
    terms: Vector
    motion: Vector


def new_motion_bins(lags_s: Vector) -> MotionBins:
    """Nothing came yet."""
    return MotionBins(
        lags_s,
        np.array([NEVER_BIN, 0, 0]),
        np.zeros((2, COMMANDS)),
        np.zeros(2),
        np.zeros((2, 2, WIDTH)),
        np.zeros(TERMS),
        np.zeros(AXES),
    )


@compiled
def add_imu_sample(cells: MotionBins, t_us: int, rates_force: Vector) -> bool:
    """Add an IMU sample, rates and specific force (6,); whether `terms` and `motion` are new."""
    number = t_us // BIN_US
    clock, ready = cells.clock, False
    if number != clock[NUMBER]:
        if number == clock[NUMBER] + 1:
            ready = clock[HAS_PREVIOUS] == 1 and _close(cells)
            clock[HAS_PREVIOUS] = 1
        else:  # a gap, or the first sample
            clock[HAS_PREVIOUS] = 0
            cells.commands[1] = cells.commands[0]
        clock[NUMBER] = number
        cells.sums[1] = cells.sums[0]
        cells.sums[0] = 0.0
    else:
        elapsed_s = max(0, t_us - clock[SAMPLE_US]) * 1e-6
        _lag(cells.commands, elapsed_s, cells.lags_s)
    clock[SAMPLE_US] = t_us
    _add(cells, (t_us - number * BIN_US) / BIN_US, rates_force)
    return ready


@compiled
def _lag(commands: Vector, elapsed_s: float, lags_s: Vector) -> None:
    for i in range(COMMANDS):
        share = 1.0 - math.exp(-elapsed_s / lags_s[i]) if lags_s[i] > 0.0 else 1.0
        commands[1, i] += share * (commands[0, i] - commands[1, i])


@compiled
def _add(cells: MotionBins, at: float, rates_force: Vector) -> None:
    """Add a sample at a time of 0 to 1 in its cell."""
    for k in range(2):
        weight = at if k else 1.0
        row = cells.sums[0, k]
        row[COUNT] += weight
        row[TIME] += weight * at
        for i in range(6):
            row[RATES + i] += weight * rates_force[i]
        for i in range(COMMANDS):
            row[LAGGED + i] += weight * cells.commands[1, i]
        row[AIR] += weight * cells.air[VALUE_MPS]


@compiled
def _close(cells: MotionBins) -> bool:
    """Terms and motion of the two cells in `sums`, the second of which is full."""
    now, before = cells.sums[0], cells.sums[1]
    if now[0, COUNT] == 0.0 or before[0, COUNT] == 0.0:
        return False
    apart_s = (1.0 + now[0, TIME] / now[0, COUNT] - before[0, TIME] / before[0, COUNT]) * (
        BIN_US * 1e-6
    )
    # The weight rises over the cell before and falls over this one.
    total = before[1, COUNT] + now[0, COUNT] - now[1, COUNT]
    if total <= 0.0:
        return False
    terms, motion = cells.terms, cells.motion
    terms[CONSTANT] = 1.0
    for i in range(COMMANDS):
        at = LAGGED + i
        terms[OUTPUT + i] = (before[1, at] + now[0, at] - now[1, at]) / total
    for i in range(3):
        at = RATES + i
        terms[RATE + i] = (before[1, at] + now[0, at] - now[1, at]) / total
        motion[i] = (now[0, at] / now[0, COUNT] - before[0, at] / before[0, COUNT]) / apart_s
    for i in range(3):
        at = FORCES + i
        force = (before[1, at] + now[0, at] - now[1, at]) / total
        if i == 0:
            motion[FORWARD] = motion[FORWARD_BY_AIRSPEED] = force
        else:
            terms[FORCE + i - 1] = force
    motion[DOWN] = terms[FORCE + 1]
    known = cells.clock[SAMPLE_US] < cells.air[UNTIL_US]
    terms[AIRSPEED] = (before[1, AIR] + now[0, AIR] - now[1, AIR]) / total if known else 0.0
    return True
