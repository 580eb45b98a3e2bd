"""The detector's state; every step hands back a new one."""

from typing import NamedTuple

from analysis.detection.filter.filter_state import (
    Exclusion,
    MotionEstimate,
    PendingImu,
    StoredOrbit,
)
from analysis.detection.filter.lasting_errors import VarianceFactor
from analysis.detection.filter.measurement import EphemerisSelection, EpochObservation
from analysis.detection.filter.propagation import ImuSegment, imu_segment
from analysis.detection.isolation.common_shift import CommonShift
from analysis.detection.isolation.ramp_test import RampBank
from analysis.detection.receiver.carry_off_windows import CarryOff, CarryOffWindows
from analysis.detection.receiver.fix_latency import Latency
from analysis.detection.receiver.frozen_fix import FixRepeats
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector

RECEIVER = "GPS"  # the receiver's name among what is excluded
NOTHING_EXCLUDED: dict[str, Exclusion] = {}
NO_RATES_OFF: dict[str, int] = {}


class LastFix(NamedTuple):
    """A receiver's fix, as the next one is held against it.

    `v_ned_mps` (3,) is its velocity, NaN where unknown. `forces_b_mps2` are the mean specific
    forces (3,) of the newest intervals up to it, the newest first (none where there was no IMU),
    `off_mps` (3,) is how far the receiver's velocity then lay off the filter's.
    """

    t_us: int
    r_ecef_m: Vector
    v_ned_mps: Vector
    forces_b_mps2: tuple[Vector, ...]
    off_mps: Vector


class FrozenOffsets(Value, frozen=True):
    """Offsets in m of satellites' ranges at `t_us`, subtracted since other satellites are used."""

    t_us: int
    offsets_m: dict[str, float]


NOTHING_FROZEN = FrozenOffsets(0, {})


class DetectorCore(Value, frozen=True):
    """Everything but the pending IMU samples.

    `ionosphere` (9,) are Klobuchar's coefficients and how much more than broadcast ones they may be
    off.
    `imu_interval_s` is the usual time between two of its samples (0: not known),
    `imu_bad_until_us` is when a faulty IMU is tried again (None: it is trusted), `unknown_since_us`
    since when no epoch could be used, `distrusted` what of all satellites together was wrong at the
    last one ("ranges", "rates" or nothing). `ranges_us` is when raw ranges were last usable,
    `frozen` what is subtracted from them; `gps_source`, `last_fix`, `latency` and `repeats` serve
    when there are none, `carry` are the windows that look for one that is carried off, `carried` is
    how one left out was moved, and `unbounded` says that the filter may follow a lying receiver,
    `led` that it follows satellites which were found to lie all together.
    `spacing_us` is the time between epochs (0: not known), `gap_us` the newest that was another;
    `before` is the filter as it was before a gap too long; `misfit` is how the ranges have fitted
    for the last minute;
    `leapt_m` (3,) is how far all satellites together leapt, with nothing to tell whether rightly;
    `rates_off` counts the epochs running in which a satellite's Doppler rate alone was wrong,
    `watched` is for a velocity that all rates show.
    """

    motion: MotionEstimate | None
    ephemerides: dict[str, tuple[StoredOrbit, ...]]
    ionosphere: Vector
    excluded: dict[str, Exclusion] = NOTHING_EXCLUDED
    frozen: FrozenOffsets = NOTHING_FROZEN
    imu_id: int | None = None
    imu_interval_s: float = 0.0
    imu_bad_until_us: int | None = None
    mag_b: Vector | None = None
    unknown_since_us: int | None = None
    distrusted: str = ""
    ranges_us: int | None = None
    chosen: EphemerisSelection | None = None
    ramps: RampBank | None = None
    history: "tuple[EpochRecord, ...]" = ()
    gps_source: str | None = None
    last_fix: LastFix | None = None
    latency: Latency = Latency()
    repeats: FixRepeats = FixRepeats()
    carry: CarryOffWindows | None = None
    carried: CarryOff | None = None
    unbounded: bool = False
    led: bool = False
    spacing_us: int = 0
    gap_us: int = 0
    before: MotionEstimate | None = None
    misfit: VarianceFactor = VarianceFactor()
    leapt_m: Vector | None = None
    rates_off: dict[str, int] = NO_RATES_OFF
    watched: CommonShift = CommonShift()


class EpochRecord(Value, frozen=True, eq=False):
    """A snapshot of one epoch, for a replay: the core before it, what was observed, and what the
    IMU gave until then. Itself alone is its equal: what was reckoned of it is kept by it."""

    t_us: int
    core: DetectorCore
    observed: EpochObservation
    run: ImuRun

    @property
    def part(self) -> ImuSegment:
        """The IMU since the epoch before."""
        assert self.core.motion is not None
        return imu_segment(self.run, self.core.motion, self.t_us)


class DetectorState(NamedTuple):
    """The detector's state; `mag_b` (3,) is the newest sample of the magnetometer."""

    core: DetectorCore
    pending: PendingImu | None = None
    mag_b: Vector | None = None
