"""The detector's outcome in the words of `analysis.results`."""

import math
from collections.abc import Iterable
from typing import Any

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.epoch_outcome import EpochOutcome, reported_hypothesis
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.initial_fix import InitialFix
from analysis.detection.filter.measurement import EpochObservation
from analysis.detection.filter.propagation import is_silent
from analysis.detection.isolation.all_satellites import FOLLOWED_REASON, JUMP_REASON
from analysis.detection.isolation.chi_square import chi_square_threshold, p_value
from analysis.detection.protection_levels import LARGEST_LEVEL_M, PositionBounds, level_assumptions
from analysis.detection.streams.pause_filter import IMU_SILENT
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.sample import Epoch


def build_decision(
    epoch: Epoch, outcome: EpochOutcome, core: DetectorCore, late: bool, config: DetectorConfig
) -> Decision:
    """The decision on a tested epoch; `late` says that a fault was found by its past."""
    motion, slow, dof = core.motion, outcome.slow, outcome.parity_dof
    bounds = None if outcome.unbounded else outcome.bounds
    onsets = [entry.onset_us for entry in core.excluded.values()]
    # A fault found by its past is one of satellites, also where this epoch passed.
    hypothesis = "satellites" if late and outcome.hypothesis == "none" else outcome.hypothesis
    return Decision(
        t_us=epoch.t_us,
        statistic=outcome.statistic,
        threshold=outcome.threshold,
        dof=len(outcome.names),
        p_value=p_value(outcome.statistic, len(outcome.names)),
        alarm=outcome.alarm or late,
        hypothesis=hypothesis,
        excluded=tuple(sorted(core.excluded)),
        satellites=outcome.names + outcome.excluded,
        residual_m=tuple(outcome.residual_m),
        normalised=tuple(outcome.normalised),
        # The newest onset: older exclusions were told before.
        onset_us=max(onsets, default=None),
        probabilities=dict(outcome.probabilities),
        position_ecef_m=_position(motion) if motion is not None else None,
        position_sigma_m=_sigma(motion, bounds) if motion and not outcome.unbounded else None,
        **_levels(bounds, [n for i, n in enumerate(outcome.names) if i not in outcome.faulty]),
        reason=outcome.unbounded,
        mode="inertial" if motion is not None and motion.inertial else "free",
        # Without a degree of freedom there is no test: zeros, not NaN.
        parity_statistic=outcome.parity if dof else 0.0,
        parity_threshold=chi_square_threshold(dof, config.p_false_alarm) if dof else 0.0,
        parity_dof=dof,
        slow_statistic=slow.statistic if slow is not None else None,
        slow_threshold=slow.threshold if slow is not None else None,
    )


def build_start_decision(
    epoch: Epoch, observed: EpochObservation, begun: InitialFix, core: DetectorCore
) -> Decision:
    """The decision on the epoch the filter started with."""
    motion = begun.motion
    unbounded = (
        JUMP_REASON if core.leapt_m is not None else FOLLOWED_REASON if core.unbounded else ""
    )
    assert motion is not None
    few = "" if begun.dof > 1 else "a start with 1 degree of freedom: it tests little"
    bounds = None if unbounded else begun.bounds
    return Decision(
        t_us=epoch.t_us,
        statistic=begun.statistic,
        threshold=begun.threshold,
        dof=begun.dof,
        p_value=p_value(begun.statistic, begun.dof),
        alarm=bool(begun.faulty),
        hypothesis=reported_hypothesis(core, "none", False, False),
        excluded=tuple(sorted(core.excluded)),
        satellites=observed.satellites,
        position_ecef_m=_position(motion),
        position_sigma_m=None if unbounded else _sigma(motion, bounds),
        **_levels(bounds, observed.satellites),
        mode="start",
        # One degree of freedom finds a fault, but not whose it is.
        reason=unbounded or few,
    )


def untestable_decision(t_us: int, reason: str, excluded: Iterable[str] = ()) -> Decision:
    """No decision, and why."""
    return Decision(
        t_us=t_us,
        statistic=None,
        threshold=None,
        dof=0,
        p_value=None,
        alarm=False,
        hypothesis="untestable",
        excluded=tuple(sorted(excluded)),
        reason=reason,
    )


def imu_results(epoch: Epoch, outcome: EpochOutcome, config: DetectorConfig) -> list[Result]:
    """What the epoch says of the IMU: silence, and the test of the velocity it predicts."""
    silent = is_silent(outcome.gap_s, outcome.core.imu_interval_s, config)
    faulty = silent or (outcome.imu_blamed and outcome.hypothesis == "imu")
    # Silence is told even without rates to test.
    if not outcome.was_inertial or (outcome.rate is None and not faulty):
        return []
    return [
        SensorDecision(
            t_us=epoch.t_us,
            sensor="imu",
            statistic=outcome.rate,
            threshold=outcome.rate_threshold,
            dof=outcome.rate_dof,
            alarm=faulty,
            isolated=faulty,
            reason=f"{IMU_SILENT} {outcome.gap_s:.2f} s" if silent else "",
        )
    ]


def rate_results(epoch: Epoch, outcome: EpochOutcome) -> list[Result]:
    """The satellites whose Doppler rate contradicts the others' and the prediction: left out of the
    velocity alone."""
    return [
        SensorDecision(
            t_us=epoch.t_us,
            sensor="satellites",
            suspect=name,
            statistic=outcome.rate,
            threshold=outcome.rate_threshold,
            dof=outcome.rate_dof,
            alarm=True,
            isolated=True,
            reason="its Doppler rate is wrong, its range is not",
        )
        for name in outcome.rate_faulty
    ]


def _position(motion: MotionEstimate) -> tuple[float, float, float]:
    x = motion.x
    return x.item(0), x.item(1), x.item(2)


def _sigma(motion: MotionEstimate, bounds: PositionBounds | None) -> tuple[float, float, float]:
    """What averages out and what lasts, together."""
    p, (x, y, z) = motion.p, bounds.lasting_m2 if bounds is not None else (0.0, 0.0, 0.0)
    f = bounds.factor if bounds is not None else 1.0
    return (
        math.sqrt(f * p.item(0, 0) + x),
        math.sqrt(f * p.item(1, 1) + y),
        math.sqrt(f * p.item(2, 2) + z),
    )


def _levels(bounds: PositionBounds | None, names: Iterable[str]) -> dict[str, Any]:
    """The protection levels, with what they assume of the satellites in use."""
    if bounds is None:
        return {}
    levels = {"hpl_m": _level(bounds.hpl_m), "vpl_m": _level(bounds.vpl_m)}
    return {**levels, "level_assumes": level_assumptions(names)} if any(levels.values()) else levels


def _level(level_m: float) -> float | None:
    """A protection level as it is told; None where there is none."""
    return round(level_m, 3) if level_m < LARGEST_LEVEL_M else None
