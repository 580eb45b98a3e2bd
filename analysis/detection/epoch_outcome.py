"""What the detector found at one epoch, before it is put in words."""

from collections.abc import Mapping, Sequence

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.isolation.ramp_test import RampVerdict
from analysis.detection.protection_levels import PositionBounds
from analysis.detection.receiver.receiver_or_imu import UNDECIDED
from analysis.detection.values import Value


class EpochOutcome(Value, frozen=True):
    """The core after an epoch and what the epoch showed; nothing but `reason` where it could not be
    tested.

    `names` are the satellites that were used, `faulty` the places of those found faulty among
    them, `excluded` those excluded before; innovations `residual_m` and `normalised` are of both.
    The tests: the main one, `parity` over `parity_dof` degrees of freedom, the rates' over
    `rate_dof` (None: there were too few) with the names whose rates alone were found wrong, and the
    slow one. `gap_s` is how long the IMU was silent,
    where that matters, `bounds` are those of the position, and `unbounded`
    says why there are none.
    """

    core: DetectorCore
    reason: str = ""
    names: tuple[str, ...] = ()
    faulty: tuple[int, ...] = ()
    excluded: tuple[str, ...] = ()
    residual_m: Sequence[float] = ()
    normalised: Sequence[float] = ()
    statistic: float = 0.0
    threshold: float = 0.0
    probabilities: Mapping[str, float] = {}
    parity: float = 0.0
    parity_dof: int = 0
    rate: float | None = None
    rate_threshold: float | None = None
    rate_dof: int = 0
    rate_faulty: tuple[str, ...] = ()
    slow: RampVerdict | None = None
    hypothesis: str = "untestable"
    alarm: bool = False
    imu_blamed: bool = False
    was_inertial: bool = False
    gap_s: float = 0.0
    bounds: PositionBounds | None = None
    unbounded: str = ""


def reported_hypothesis(core: DetectorCore, hypothesis: str, imu: bool, leapt: bool) -> str:
    """The hypothesis of the epoch; an isolation holds until it is taken back."""
    accused = UNDECIDED if core.unbounded else "imu"
    if imu:
        return accused
    if hypothesis != "none":
        return hypothesis
    if leapt:
        return "clock"
    if core.imu_bad_until_us is not None:
        return accused
    if core.leapt_m is not None:
        return "gps"
    return "satellites" if core.excluded else "none"


def next_imu_suspension_us(
    core: DetectorCore, blamed: bool, t_us: int, config: DetectorConfig
) -> int | None:
    """Until when the IMU is held out: for a while once it was blamed."""
    if blamed:
        return t_us + round(config.imu_hold_s * 1e6)
    until_us = core.imu_bad_until_us
    # Its time is over: it is trusted again.
    return None if until_us is not None and t_us >= until_us else until_us
