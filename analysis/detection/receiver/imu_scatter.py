"""Whether the IMU's samples scatter between two fixes as they never did: spikes, an impact.

The integral of such samples is not to be relied upon: a spike steps the filter's velocity, which
looks just like a receiver that is carried off with it.
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.propagation import ImuSegment
from analysis.samples.sample import Vector

CHANNELS = slice(1, 7)  # columns of rates and specific force, after the time
LEAST_SAMPLES, MEMORY_FIXES = 4, 60  # samples of a mean square; memory of the level, 12 s at 5 Hz
# Of a mean square, logarithmic: 50 times the usual noise. The turns of a wing reach 27 at 100 Hz,
# spikes and touchdowns 88 or more.
LARGEST_GAIN = np.log(2500.0)
QUIETEST = 1e-18  # a variance of a value that repeats: far below the resolution of any sensor


class ImuScatter(NamedTuple):
    """The usual logarithms (6,) of the mean squared changes from sample to sample, over how many
    intervals, and when one last exceeded it by far."""

    level: Vector = np.zeros(6)
    intervals: int = 0
    shaken_us: int = -(1 << 40)


def update_scatter(known: ImuScatter, segment: ImuSegment, t_us: int) -> ImuScatter:
    """The scatter after an interval up to `t_us`; a lasting change becomes the usual one."""
    samples = segment.samples[:, CHANNELS]
    if len(samples) < LEAST_SAMPLES:
        return known
    now = np.log((np.diff(samples, axis=0) ** 2).mean(axis=0) + QUIETEST)
    if not np.isfinite(now).all():
        return known._replace(shaken_us=t_us)
    gain, count = now - known.level, min(known.intervals + 1, MEMORY_FIXES)
    shaken = known.intervals > 0 and gain.max() > LARGEST_GAIN
    step = np.minimum(gain, LARGEST_GAIN) / count
    level = now if known.intervals == 0 else known.level + step
    return ImuScatter(level, count, t_us if shaken else known.shaken_us)
