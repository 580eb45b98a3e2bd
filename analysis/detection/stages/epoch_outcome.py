"""The detector's findings at one epoch, before they become a result."""

from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.filter_state import ImuStatus
from analysis.detection.isolation.exclusion import NONE_EXCLUDED, ExcludedInnovations
from analysis.detection.isolation.isolation_config import IsolationConfig
from analysis.detection.isolation.trust import Trust
from analysis.detection.protection_levels import PositionBounds
from analysis.detection.receiver.receiver_or_imu import UNDECIDED
from analysis.detection.stages.assess import Assessment
from analysis.detection.stages.isolate import EpochVerdict
from analysis.detection.values import Value


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
    imu: ImuStatus, isolated: bool, t_us: int, config: IsolationConfig
) -> ImuStatus:
    """The IMU after an epoch: not used for a while once it is isolated."""
    until_us = imu.suspended_until_us
    if isolated:
        return imu._replace(suspended_until_us=t_us + round(config.imu_hold_s * 1e6))
    # The suspension is over: the IMU is trusted again.
    is_over = until_us is not None and t_us >= until_us
    return imu._replace(suspended_until_us=None) if is_over else imu
