"""The results of a receiver's fix, as `analysis.results` has them."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.propagation import is_silent
from analysis.detection.receiver.position_test import FixTest
from analysis.detection.statistics.chi_square import p_value
from analysis.detection.streams.pause_filter import IMU_SILENT
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.sample import GpsFix

RECEIVER = "GPS"  # the receiver's name among the exclusions
LASTING_SHARE = 0.6  # of a receiver's error that lasts for minutes: no filter averages it out
UNBOUNDED_REASON = (
    "the receiver or the IMU is faulty: the position follows the receiver, its error is unbounded"
)
EXCLUDED_REASON = "the receiver is excluded: the position is the IMU's alone, without a bound"


def build_fix_decision(
    fix: GpsFix,
    core: DetectorCore,
    position: FixTest | None,
    hypothesis: str,
    alarm: bool,
    mode: str,
) -> Decision:
    """The decision on one fix; `position` is None where the filter starts with it."""
    motion = core.motion
    assert motion is not None
    sigma = np.sqrt(np.diag(motion.p)[:3])
    reason = UNBOUNDED_REASON if core.trust.unbounded else ""
    # Once the position is less certain than a fix, a fault of the IMU would go undetected.
    if RECEIVER in core.trust.excluded and position and sigma @ sigma > position.variance.sum():
        reason = EXCLUDED_REASON
    if position is not None:
        sigma = np.sqrt(
            sigma**2 + LASTING_SHARE**2 * (position.h[:, :3] ** 2).T @ position.variance
        )
    return Decision(
        t_us=fix.t_us,
        statistic=position.statistic if position else None,
        threshold=position.threshold if position else None,
        # Three components of the position.
        dof=3 if position else 0,
        p_value=p_value(position.statistic, 3) if position else None,
        alarm=alarm,
        hypothesis=hypothesis,
        excluded=tuple(sorted(core.trust.excluded)),
        position_ecef_m=(float(motion.x[0]), float(motion.x[1]), float(motion.x[2])),
        position_sigma_m=None if reason else (float(sigma[0]), float(sigma[1]), float(sigma[2])),
        reason=reason,
        residual_m=tuple(position.v.tolist()) if position else (),
        mode=mode,
    )


def fix_sensor_decisions(
    fix: GpsFix,
    core: DetectorCore,
    position: FixTest,
    velocity: FixTest | None,
    gap_s: float,
    hypothesis: str,
    config: DetectorConfig,
) -> list[Result]:
    """The decisions on the receiver as a sensor, and on a faulty or silent IMU."""

    def decision(
        sensor: str, test: FixTest | None, alarm: bool, isolated: bool, reason: str = ""
    ) -> SensorDecision:
        return SensorDecision(
            t_us=fix.t_us,
            sensor=sensor,
            statistic=test.statistic if test else None,
            threshold=test.threshold if test else None,
            dof=len(test.v) if test else 0,
            alarm=alarm,
            isolated=isolated,
            reason=reason,
        )

    # An excluded receiver is isolated for every test that still fails.
    isolated = hypothesis == "gps" or RECEIVER in core.trust.excluded
    tests = {"gps-position": position, "gps-velocity": velocity}
    results: list[Result] = [
        decision(sensor, test, not test.passes, isolated and not test.passes)
        for sensor, test in tests.items()
        if test is not None
    ]
    silent = is_silent(gap_s, core.imu.interval_s, config)
    if silent or hypothesis == "imu":
        reason = f"{IMU_SILENT} {gap_s:.2f} s" if silent else ""
        # Silent: there was nothing to test.
        results.append(decision("imu", None if silent else velocity, True, True, reason))
    return results
