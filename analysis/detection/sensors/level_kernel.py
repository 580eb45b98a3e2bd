"""Detects a step in a quantity that is roughly constant in a healthy sensor, compiled.

A short mean is compared with a long one, relative to the usual deviation of the two. The long mean
is frozen while they differ, so that a step stays visible; after a while the new level becomes the
usual one. A return to the previous level does not count as a new step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import NEVER_US
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

FIELD, HAS_FIX = LEVELS = range(2)
# Smallest change of each level, up and down: 0.05 gauss is 10 % of the Earth's field.
UP = np.array([0.05, np.inf])  # a fix that returns is no fault
DOWN = np.array([0.05, 0.5])
CHANGE_SIGMAS = 8.0  # of the short mean about the long one, chosen
SHORT_S, LONG_S, LEARNED_S, USUAL_S = 0.3, 30.0, 4.0, 20.0  # chosen
CONFIRM_US, REPEAT_US = 300_000, 500_000
GAP_US = 1_000_000  # gap after which a level is learned again

# The last mean is the previous level; stamps in us of begin, newest, change and last report.
SHORT, LONG, SQUARE, PREVIOUS = range(4)
BEGAN, NEWEST, OFF_SINCE, REPORTED = range(4)


class LevelState(NamedTuple):
    """The state of each level: `means` (l, 4) and `stamps` (l, 4); `track_levels` changes them.

    `rate` (1,) is the newest rate of turn of the vehicle in rad/s.
    """

    means: Vector
    stamps: NDArray[np.int64]
    rate: Vector


def new_levels() -> LevelState:
    """The state before the first sample."""
    stamps = np.full((len(LEVELS), 4), NEVER_US)
    return LevelState(np.zeros((len(LEVELS), 4)), stamps, np.zeros(1))


@compiled
def track_levels(
    level: NDArray[np.int64], t_us: NDArray[np.int64], value: Vector, state: LevelState
) -> Vector:
    """The change (n,) of each quantity where it is to be reported, 0 elsewhere.

    `level`, `t_us` and `value` (n,) are the quantities in order.
    """
    changes = np.zeros(len(level))
    for i in range(len(level)):
        changes[i] = _step(
            level[i], t_us[i], value[i], state.means[level[i]], state.stamps[level[i]]
        )
    return changes


@compiled
def _step(level: int, t_us: int, value: float, means: Vector, stamps: NDArray[np.int64]) -> float:
    elapsed_us = t_us - stamps[NEWEST]
    if stamps[BEGAN] == NEVER_US or elapsed_us > GAP_US or elapsed_us < 0:
        means[:] = value, value, 0.0, np.nan
        stamps[:] = t_us, t_us, NEVER_US, NEVER_US
        return 0.0
    stamps[NEWEST] = t_us
    elapsed_s = elapsed_us * 1e-6
    means[SHORT] += min(1.0, elapsed_s / SHORT_S) * (value - means[SHORT])
    change = means[SHORT] - means[LONG]
    least = UP[level] if change > 0.0 else DOWN[level]
    known = t_us - stamps[BEGAN] > LEARNED_S * 1e6
    limit = max(least, CHANGE_SIGMAS * np.sqrt(means[SQUARE]))
    if known and abs(change) > limit and abs(means[SHORT] - means[PREVIOUS]) < limit:
        means[LONG], means[PREVIOUS], stamps[OFF_SINCE] = means[PREVIOUS], np.nan, NEVER_US
        return 0.0
    if known and abs(change) > limit:
        if stamps[OFF_SINCE] == NEVER_US:
            stamps[OFF_SINCE] = t_us
        since_us = t_us - stamps[OFF_SINCE]
        if since_us > USUAL_S * 1e6:  # a lasting change is the new level
            means[PREVIOUS], means[LONG], stamps[OFF_SINCE] = means[LONG], means[SHORT], NEVER_US
        elif since_us >= CONFIRM_US and t_us - stamps[REPORTED] >= REPEAT_US:
            stamps[REPORTED] = t_us
            return float(change)
        return 0.0
    stamps[OFF_SINCE] = NEVER_US
    age_s = (t_us - stamps[BEGAN]) * 1e-6
    # A young stream's long mean is over its age, as its first value alone is noise.
    share = min(1.0, elapsed_s / min(LONG_S, max(age_s, SHORT_S)))
    means[LONG] += share * (value - means[LONG])
    means[SQUARE] += share * (change * change - means[SQUARE])
    return 0.0
