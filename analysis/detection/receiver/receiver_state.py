"""The state of the tests of a receiver's own fixes, used without raw ranges."""

from typing import NamedTuple

import numpy as np

from analysis.detection.receiver.carry_off_windows import CarryOffWindows
from analysis.detection.receiver.fix_latency import Latency
from analysis.detection.receiver.imu_scatter import ImuScatter
from analysis.detection.streams.fix_repeats import FixRepeats
from analysis.detection.values import Value
from analysis.samples.sample import Vector


class LastFix(NamedTuple):
    """A receiver's fix, as the next one is compared with it.

    `v_ned_mps` (3,) is its velocity, NaN where unknown. `forces_b_mps2` are the mean specific
    forces (3,) of the newest intervals up to it, the newest first (none where there was no IMU),
    `off_mps` (3,) is how far the receiver's velocity then differed from the filter's.
    """

    t_us: int
    r_ecef_m: Vector
    v_ned_mps: Vector
    forces_b_mps2: tuple[Vector, ...]
    off_mps: Vector


class DriftTrack(NamedTuple):
    """How a receiver's position has moved beyond its velocities.

    `d_m` (3,) is the sum so far, along north, east and down; `marks` are older means of it with
    their times, the newest first; the open one has `mean_m` (3,) of `fixes` since `begun_us`
    (0: none yet).
    """

    d_m: Vector = np.zeros(3)
    marks: tuple[tuple[int, Vector], ...] = ()
    begun_us: int = 0
    mean_m: Vector = np.zeros(3)
    fixes: int = 0


class ReceiverState(Value, frozen=True):
    """The receiver in use: the message its fixes come in, the last fix, how late they are, how
    often they repeat, how its position drifts, how the IMU scatters between its fixes, and the
    windows that look for a slow carry-off (None: they begin anew)."""

    source: str | None = None
    last_fix: LastFix | None = None
    latency: Latency = Latency()
    repeats: FixRepeats = FixRepeats()
    drift: DriftTrack = DriftTrack()
    scatter: ImuScatter = ImuScatter()
    windows: CarryOffWindows | None = None
