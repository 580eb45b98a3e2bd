"""The results of an epoch, or of a receiver's own fix, as `analysis.results` has them."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.filter_state import ImuStatus, MotionEstimate
from analysis.detection.filter.measurement import EpochObservation
from analysis.detection.filter.propagation import is_silent
from analysis.detection.isolation.all_satellites import unbounded_reason
from analysis.detection.isolation.epoch_tests import RateVerdict
from analysis.detection.isolation.hypotheses import ONE_FOLLOWED
from analysis.detection.protection_levels import PositionBounds, level_assumptions
from analysis.detection.receiver.position_test import AssessedFix, FixTest
from analysis.detection.stages.epoch_outcome import TestedEpoch, reported_hypothesis
from analysis.detection.stages.initial_fix import InitialFix
from analysis.detection.statistics.chi_square import chi_square_threshold, p_value
from analysis.detection.streams.pause_filter import IMU_SILENT
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.sample import Epoch, GpsFix

RECEIVER = "GPS"  # the receiver's name among the exclusions
LASTING_SHARE = 0.6  # of a receiver's error that lasts for minutes: no filter averages it out
UNBOUNDED_REASON = (
    "the receiver or the IMU is faulty: the position follows the receiver, its error is unbounded"
)
EXCLUDED_REASON = "the receiver is excluded: the position is the IMU's alone, without a bound"


def build_decision(
    epoch: Epoch, tested: TestedEpoch, core: DetectorCore, late: bool, config: DetectorConfig
) -> Decision:
    """The decision on a tested epoch; `core` is the one after it, `late` says that a fault was
    found that had begun earlier."""
    assessment, ranges, ramps = tested.assessment, tested.verdict.ranges, tested.verdict.ramps
    statistics, names, motion = assessment.statistics, assessment.satellites, core.motion
    dof, excluded = statistics.parity_dof, tested.excluded
    bounds = None if tested.unbounded else tested.bounds
    used = [name for i, name in enumerate(names) if i not in ranges.faulty]
    # The levels cover these too.
    contradicting = core.trust.contradicting
    used += [name for name in names + excluded.names if name[0] in contradicting]
    onsets = [entry.onset_us for entry in core.trust.excluded.values()]
    # A fault that was found by its past is one of satellites, also where this epoch passed.
    hypothesis = "satellites" if late and tested.hypothesis == "none" else tested.hypothesis
    return Decision(
        t_us=epoch.t_us,
        statistic=ranges.statistic,
        threshold=ranges.threshold,
        dof=len(names),
        p_value=p_value(ranges.statistic, len(names)),
        alarm=tested.alarm or late,
        hypothesis=hypothesis,
        excluded=_excluded(core),
        unused=_unused(core),
        satellites=names + excluded.names,
        residual_m=(*assessment.innovations.range_m.tolist(), *excluded.range_m.tolist()),
        normalised=(*statistics.normalised.tolist(), *excluded.normalised.tolist()),
        # The newest onset: older exclusions have been reported before.
        onset_us=max(onsets, default=None),
        probabilities=dict(ranges.probabilities),
        position_ecef_m=position_of(motion) if motion is not None else None,
        **_uncertainty(None if tested.unbounded else motion, bounds),
        **_levels(bounds, used),
        reason=tested.unbounded or ONE_FOLLOWED * bool(contradicting),
        mode="inertial" if motion is not None and motion.inertial else "free",
        # Without a degree of freedom there is no test: zeros, not NaN.
        parity_statistic=statistics.parity if dof else 0.0,
        parity_threshold=chi_square_threshold(dof, config.p_false_alarm) if dof else 0.0,
        parity_dof=dof,
        slow_statistic=ramps.statistic if ramps is not None else None,
        slow_threshold=ramps.threshold if ramps is not None else None,
    )


def build_start_decision(
    epoch: Epoch, observation: EpochObservation, fix: InitialFix, core: DetectorCore
) -> Decision:
    """The decision on the epoch that the filter starts with; `core` is the one after it."""
    motion, trust, unbounded = fix.motion, core.trust, unbounded_reason(core.trust)
    assert motion is not None
    bounds = None if unbounded else fix.bounds
    return Decision(
        t_us=epoch.t_us,
        statistic=fix.statistic,
        threshold=fix.threshold,
        dof=fix.dof,
        p_value=p_value(fix.statistic, fix.dof),
        alarm=bool(fix.faulty),
        hypothesis=reported_hypothesis(trust, core.imu, "none", False, False),
        excluded=tuple(sorted(trust.excluded)),
        unused=_unused(core),
        satellites=observation.satellites,
        position_ecef_m=position_of(motion),
        **_uncertainty(None if unbounded else motion, bounds),
        **_levels(bounds, observation.satellites),
        mode="start",
        reason=unbounded,
    )


def untestable_decision(t_us: int, reason: str, excluded: Iterable[str] = ()) -> Decision:
    """No decision, and why."""
    names = tuple(sorted(excluded))
    return Decision(t_us=t_us, hypothesis="untestable", excluded=names, reason=reason)


def imu_results(
    epoch: Epoch, tested: TestedEpoch, imu: ImuStatus, config: DetectorConfig
) -> list[Result]:
    """The IMU's decision: on its silence, and on the velocity it predicts."""
    prediction, rates = tested.assessment.prediction, tested.verdict.rates
    gap_s = prediction.segment.gap_s
    silent = is_silent(gap_s, imu.interval_s, config)
    faulty = silent or (tested.imu_isolated and tested.hypothesis == "imu")
    # Silence is reported even without rates to test.
    if not prediction.before.inertial or (rates.statistic is None and not faulty):
        return []
    reason = f"{IMU_SILENT} {gap_s:.2f} s" * silent
    return [sensor_decision(epoch.t_us, "imu", rates, faulty, faulty, reason)]


def rate_results(epoch: Epoch, tested: TestedEpoch) -> list[Result]:
    """The satellites whose Doppler rate contradicts the others and the prediction: their rates are
    not used, their ranges are."""
    rates, reason = tested.verdict.rates, "its Doppler rate is wrong, its range is not"
    return [
        sensor_decision(epoch.t_us, "satellites", rates, True, True, reason, name)
        for name in tested.rate_faulty
    ]


def sensor_decision(
    t_us: int,
    sensor: str,
    test: RateVerdict | FixTest | None,
    alarm: bool,
    isolated: bool,
    reason: str = "",
    suspect: str = "",
) -> SensorDecision:
    """The decision on a sensor by a test; None if there was nothing to test."""
    return SensorDecision(
        t_us=t_us,
        sensor=sensor,
        suspect=suspect,
        statistic=test.statistic if test else None,
        threshold=test.threshold if test else None,
        dof=test.dof if test else 0,
        alarm=alarm,
        isolated=isolated,
        reason=reason,
    )


def _excluded(core: DetectorCore) -> tuple[str, ...]:
    """The excluded satellites; those of a system that may as well be right are only unused."""
    trust = core.trust
    return tuple(sorted(name for name in trust.excluded if name[0] not in trust.contradicting))


def _unused(core: DetectorCore) -> dict[str, str]:
    """Satellites in view that are neither used nor found faulty, and why."""
    known, trust = core.broadcast.selection, core.trust
    doubted = [name for name in trust.excluded if name[0] in trust.contradicting]
    why = dict.fromkeys(doubted, "its system contradicts the one that is followed")
    return {**(known.unused if known is not None else {}), **why}


def position_of(motion: MotionEstimate) -> tuple[float, float, float]:
    """The filter's position, ECEF."""
    x = motion.x
    return x.item(0), x.item(1), x.item(2)


def _uncertainty(motion: MotionEstimate | None, bounds: PositionBounds | None) -> dict[str, Any]:
    """Sigma and covariance of white and lasting errors together; none without a filter."""
    if motion is None:
        return {}
    covariance = motion.p[:3, :3]
    if bounds is not None:
        covariance = bounds.factor * covariance + bounds.lasting_m2
    xx, xy, xz, _, yy, yz, _, _, zz = covariance.ravel().tolist()
    return {
        "position_sigma_m": (math.sqrt(xx), math.sqrt(yy), math.sqrt(zz)),
        "position_covariance_m2": (xx, xy, xz, yy, yz, zz),
    }


def _levels(bounds: PositionBounds | None, names: Iterable[str]) -> dict[str, Any]:
    """The protection levels, with what they assume of the satellites in use."""
    if bounds is None:
        return {}
    levels = {"hpl_m": _level(bounds.hpl_m), "vpl_m": _level(bounds.vpl_m)}
    return {**levels, "level_assumes": level_assumptions(names)} if any(levels.values()) else levels


def _level(level_m: float) -> float | None:
    """A protection level as reported; None where there is none."""
    return round(level_m, 3) if math.isfinite(level_m) else None


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
        position_ecef_m=position_of(motion),
        position_sigma_m=None if reason else (float(sigma[0]), float(sigma[1]), float(sigma[2])),
        reason=reason,
        residual_m=tuple(position.v.tolist()) if position else (),
        mode=mode,
    )


def fix_sensor_decisions(
    fix: GpsFix,
    core: DetectorCore,
    assessed: AssessedFix,
    gap_s: float,
    hypothesis: str,
    config: DetectorConfig,
) -> list[Result]:
    """The decisions on the receiver as a sensor, and on a faulty or silent IMU."""
    # An excluded receiver is isolated for every test that still fails.
    isolated = hypothesis == "gps" or RECEIVER in core.trust.excluded
    tests = {"gps-position": assessed.position, "gps-velocity": assessed.velocity}
    results: list[Result] = [
        sensor_decision(fix.t_us, sensor, test, not test.passes, isolated and not test.passes)
        for sensor, test in tests.items()
        if test is not None
    ]
    silent = is_silent(gap_s, core.imu.interval_s, config)
    if silent or hypothesis == "imu":
        reason = f"{IMU_SILENT} {gap_s:.2f} s" if silent else ""
        # Silent: there was nothing to test.
        test = None if silent else assessed.velocity
        results.append(sensor_decision(fix.t_us, "imu", test, True, True, reason))
    return results
