"""The state of the tests of a receiver's own fixes, used without raw ranges."""

from typing import NamedTuple

from analysis.detection.receiver.carry_off_windows import CarryOffWindows
from analysis.detection.receiver.fix_latency import Latency
from analysis.detection.receiver.frozen_fix import FixRepeats
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


class ReceiverState(Value, frozen=True):
    """The receiver in use: the message its fixes come in, the last fix, how late they are, how
    often they repeat, and the windows that look for a slow carry-off (None: they begin anew)."""

    source: str | None = None
    last_fix: LastFix | None = None
    latency: Latency = Latency()
    repeats: FixRepeats = FixRepeats()
    windows: CarryOffWindows | None = None
