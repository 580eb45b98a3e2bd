"""Quantities that stay about the same in sound sensors, compiled: whether one has left its level.

Of each quantity a short mean is held against a long one, and against how far the short mean usually
lies from it. The long mean waits while they differ, so that a step stays one; after a while the new
level is the usual one. Who comes back to the level from before is not off again.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

FIELD, HAS_FIX = LEVELS = range(2)
# Of each level: the least change that counts, upwards and downwards
UP = np.array([0.05, np.inf])  # a fix that comes back is no fault
DOWN = np.array([0.05, 0.5])
CHANGE_SIGMAS = 8.0  # of the short mean about the long one
SHORT_S, LONG_S, LEARNED_S, USUAL_S = 0.3, 30.0, 4.0, 20.0
CONFIRM_US, REPEAT_US = 300_000, 500_000
GAP_US = 1_000_000  # after which a stream begins anew

# Of the means, the last is the level from before; of the stamps in us: begin, newest, since when it
# is off, when that was told last
SHORT, LONG, SQUARE, PREVIOUS = range(4)
BEGAN, NEWEST, OFF_SINCE, REPORTED = range(4)
NEVER_US = -(1 << 62)


class LevelState(NamedTuple):
    """What is known of each level: `means` (l, 4) and `stamps` (l, 4); `track_levels` changes them.

    `rate` (1,) is how fast the vehicle turned when it was measured last, in rad/s.
    """

    means: Vector
    stamps: NDArray[np.int64]
    rate: Vector


def new_levels() -> LevelState:
    """Nothing came yet."""
    stamps = np.full((len(LEVELS), 4), NEVER_US)
    return LevelState(np.zeros((len(LEVELS), 4)), stamps, np.zeros(1))


@compiled
def track_levels(
    level: NDArray[np.int64], t_us: NDArray[np.int64], value: Vector, kept: LevelState
) -> Vector:
    """How far (n,) each quantity is off where that is to be told, 0 elsewhere.

    `level`, `t_us` and `value` (n,) are the quantities in their order.
    """
    off = np.zeros(len(level))
    for i in range(len(level)):
        off[i] = _step(level[i], t_us[i], value[i], kept.means[level[i]], kept.stamps[level[i]])
    return off


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
        if since_us > USUAL_S * 1e6:  # what lasts is what it is like now
            means[PREVIOUS], means[LONG], stamps[OFF_SINCE] = means[LONG], means[SHORT], NEVER_US
        elif since_us >= CONFIRM_US and t_us - stamps[REPORTED] >= REPEAT_US:
            stamps[REPORTED] = t_us
            return float(change)
        return 0.0
    stamps[OFF_SINCE] = NEVER_US
    age_s = (t_us - stamps[BEGAN]) * 1e-6
    # A young stream's long mean is that of its age: its first value alone means little.
    share = min(1.0, elapsed_s / min(LONG_S, max(age_s, SHORT_S)))
    means[LONG] += share * (value - means[LONG])
    means[SQUARE] += share * (change * change - means[SQUARE])
    return 0.0
