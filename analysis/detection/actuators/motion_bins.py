"""Averages samples over time bins of 0.1 s, compiled: mean motion and the terms that predict it.

The mean rates of two adjacent bins differ by the angular acceleration, weighted by a triangle that
rises over the first bin and falls over the second. Commands, rates and specific force have the same
weights, so that all refer to the same time. Commands first pass the motors' and servos' lag.
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

# Of a bin's `clock`: its number, the newest sample's stamp, and whether the bin before it is full
NUMBER, SAMPLE_US, HAS_PREVIOUS = range(3)
# Of `sums`: samples, their times in the bin, rates, specific force, lagged commands, airspeed; then
# the same weighted by the time in the bin, which rises from 0 to 1
COUNT, TIME, RATES, FORCES, LAGGED = 0, 1, 2, 5, 8
AIR = LAGGED + COMMANDS
WIDTH = AIR + 1
VALUE_MPS, UNTIL_US = range(2)  # of `air`
AIR_LASTS_US = 300_000  # validity of an airspeed: three intervals at 10 Hz


class MotionBins(NamedTuple):
    """The bin that is being filled and the one before; `add_imu_sample` changes them in place.

    `lags_s` (COMMANDS,) of the actuators; `clock` (3,) as named above; `commands` (2, COMMANDS):
    the newest, and the lagged; `air` (2,): the newest airspeed and until when it is valid; `sums`
    (2, 2, WIDTH): this bin and the one before, plain and weighted. `terms` (TERMS,) and `motion`
    (AXES,) are those of the last two full bins; without an airspeed its term is 0.
    """

    lags_s: Vector
    clock: NDArray[np.int64]
    commands: Vector
    air: Vector
    sums: Vector
    terms: Vector
    motion: Vector


def new_motion_bins(lags_s: Vector) -> MotionBins:
    """Empty bins."""
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
def add_imu_sample(bins: MotionBins, t_us: int, rates_force: Vector) -> bool:
    """Add an IMU sample, rates and specific force (6,); whether `terms` and `motion` are new."""
    number = t_us // BIN_US
    clock, ready = bins.clock, False
    if number != clock[NUMBER]:
        if number == clock[NUMBER] + 1:
            ready = clock[HAS_PREVIOUS] == 1 and _close(bins)
            clock[HAS_PREVIOUS] = 1
        else:  # a gap, or the first sample
            clock[HAS_PREVIOUS] = 0
            bins.commands[1] = bins.commands[0]
        clock[NUMBER] = number
        bins.sums[1] = bins.sums[0]
        bins.sums[0] = 0.0
    else:
        elapsed_s = max(0, t_us - clock[SAMPLE_US]) * 1e-6
        _lag(bins.commands, elapsed_s, bins.lags_s)
    clock[SAMPLE_US] = t_us
    _add(bins, (t_us - number * BIN_US) / BIN_US, rates_force)
    return ready


@compiled
def _lag(commands: Vector, elapsed_s: float, lags_s: Vector) -> None:
    for i in range(COMMANDS):
        share = 1.0 - math.exp(-elapsed_s / lags_s[i]) if lags_s[i] > 0.0 else 1.0
        commands[1, i] += share * (commands[0, i] - commands[1, i])


@compiled
def _add(bins: MotionBins, at: float, rates_force: Vector) -> None:
    """Add a sample at a time of 0 to 1 in its bin."""
    for k in range(2):
        weight = at if k else 1.0
        row = bins.sums[0, k]
        row[COUNT] += weight
        row[TIME] += weight * at
        for i in range(6):
            row[RATES + i] += weight * rates_force[i]
        for i in range(COMMANDS):
            row[LAGGED + i] += weight * bins.commands[1, i]
        row[AIR] += weight * bins.air[VALUE_MPS]


@compiled
def _close(bins: MotionBins) -> bool:
    """Compute terms and motion of the two bins in `sums`, the second of which is full."""
    newer, older = bins.sums[0], bins.sums[1]
    if newer[0, COUNT] == 0.0 or older[0, COUNT] == 0.0:
        return False
    apart_s = (1.0 + newer[0, TIME] / newer[0, COUNT] - older[0, TIME] / older[0, COUNT]) * (
        BIN_US * 1e-6
    )
    # The weight rises over the older bin and falls over the newer one.
    total = older[1, COUNT] + newer[0, COUNT] - newer[1, COUNT]
    if total <= 0.0:
        return False
    terms, motion = bins.terms, bins.motion
    terms[CONSTANT] = 1.0
    for i in range(COMMANDS):
        at = LAGGED + i
        terms[OUTPUT + i] = (older[1, at] + newer[0, at] - newer[1, at]) / total
    for i in range(3):
        at = RATES + i
        terms[RATE + i] = (older[1, at] + newer[0, at] - newer[1, at]) / total
        motion[i] = (newer[0, at] / newer[0, COUNT] - older[0, at] / older[0, COUNT]) / apart_s
    for i in range(3):
        at = FORCES + i
        force = (older[1, at] + newer[0, at] - newer[1, at]) / total
        if i == 0:
            motion[FORWARD] = motion[FORWARD_BY_AIRSPEED] = force
        else:
            terms[FORCE + i - 1] = force
    motion[DOWN] = terms[FORCE + 1]
    known = bins.clock[SAMPLE_US] < bins.air[UNTIL_US]
    terms[AIRSPEED] = (older[1, AIR] + newer[0, AIR] - newer[1, AIR]) / total if known else 0.0
    return True
