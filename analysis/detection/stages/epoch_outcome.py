"""The detector's findings at one epoch, before they become a result."""

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.filter_state import ImuStatus, MotionEstimate
from analysis.detection.isolation.epoch_statistics import LEAST_RATES
from analysis.detection.isolation.epoch_tests import RangeVerdict, RateVerdict
from analysis.detection.isolation.exclusion import NONE_EXCLUDED, ExcludedInnovations
from analysis.detection.isolation.ramp_test import RampBank, RampVerdict
from analysis.detection.isolation.trust import Trust
from analysis.detection.protection_levels import PositionBounds
from analysis.detection.receiver.carry_off_windows import CarryOff
from analysis.detection.receiver.receiver_or_imu import UNDECIDED
from analysis.detection.stages.assess import Assessment
from analysis.detection.values import Value
from analysis.samples.sample import Vector


class FilterUpdate(Value, frozen=True):
    """The filter after the epoch, with its ramp tests and their verdict (None: they restart)."""

    motion: MotionEstimate
    ramps: RampBank | None = None
    verdict: RampVerdict | None = None


class EpochVerdict(Value, frozen=True):
    """The joint verdict of the tests of an epoch.

    `source` is the faulty source where `rates` or `ranges` isolate the IMU: the IMU itself, or
    undecided. `jump_m` (3,) is how far all satellites have jumped, `carry_off` how they carry the
    filter off, `shift` the statistic of the velocity that all rates share. `update` is the filter
    after the epoch; where it is None, the usable innovations are still to be used.
    """

    rates: RateVerdict
    ranges: RangeVerdict
    source: str = "imu"
    carry_off: CarryOff | None = None
    jump_m: Vector | None = None
    shift: float = 0.0
    update: FilterUpdate | None = None

    @property
    def ramps(self) -> RampVerdict | None:
        """The verdict of the ramp tests; None where they were not made."""
        return self.update.verdict if self.update is not None else None

    def has_passed(self, assessment: Assessment, doppler: bool) -> bool:
        """Whether an epoch that the IMU has predicted passed every test, with rates to compare."""
        ramps = self.ramps
        if ramps is None or {ramps.hypothesis, self.rates.hypothesis, self.ranges.hypothesis} != {
            "none"
        }:
            return False
        known = doppler and assessment.statistics.rate_count >= LEAST_RATES
        return known and assessment.prediction.before.inertial and self.ranges.motion.inertial


class TestedEpoch(Value, frozen=True):
    """An epoch that was tested: its assessment, its verdict and the reported result.

    `excluded` are the innovations of excluded satellites after the epoch, `rate_faulty` the
    satellites whose Doppler rates alone were wrong several times in a row. `hypothesis` and `alarm`
    are as reported; `imu_isolated` says that a test isolated the IMU. `bounds` are those of the
    position, `unbounded` says why they do not hold.
    """

    assessment: Assessment
    verdict: EpochVerdict
    hypothesis: str
    alarm: bool
    imu_isolated: bool
    bounds: PositionBounds
    unbounded: str
    excluded: ExcludedInnovations = NONE_EXCLUDED
    rate_faulty: tuple[str, ...] = ()


class EpochOutcome(Value, frozen=True):
    """The core after an epoch, and the tested epoch; or the reason why it could not be tested."""

    core: DetectorCore
    tested: TestedEpoch | None = None
    reason: str = ""


def reported_hypothesis(
    trust: Trust, imu: ImuStatus, hypothesis: str, imu_faulty: bool, clock_jumped: bool
) -> str:
    """The hypothesis of the epoch; an isolation holds until it is withdrawn."""
    by_imu = UNDECIDED if trust.unbounded else "imu"
    if imu_faulty:
        return by_imu
    if hypothesis != "none":
        return hypothesis
    if clock_jumped:
        return "clock"
    if imu.suspended_until_us is not None:
        return by_imu
    if trust.jump_m is not None:
        return "gps"
    if trust.contradicting:
        return "multiple-unknown"
    return "satellites" if trust.excluded else "none"


def update_suspension(
    imu: ImuStatus, isolated: bool, t_us: int, config: DetectorConfig
) -> ImuStatus:
    """The IMU after an epoch: not used for a while once it is isolated."""
    until_us = imu.suspended_until_us
    if isolated:
        return imu._replace(suspended_until_us=t_us + round(config.imu_hold_s * 1e6))
    # The suspension is over: the IMU is trusted again.
    is_over = until_us is not None and t_us >= until_us
    return imu._replace(suspended_until_us=None) if is_over else imu
