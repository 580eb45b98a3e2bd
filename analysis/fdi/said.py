"""The detector's outcome in the words of `analysis.results`."""

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import Core
from analysis.fdi.epoch import Outcome
from analysis.fdi.measure import Observed
from analysis.fdi.motion import Segment
from analysis.fdi.start import Start
from analysis.fdi.thresholds import p_value
from analysis.results import Decision, Result, SensorDecision
from analysis.samples import Epoch, Vector


def decision(epoch: Epoch, outcome: Outcome, core: Core, late: bool) -> Decision:
    """The decision on a tested epoch; `late` says that a fault was found by its past."""
    tested, used, motion = outcome.tested, outcome.used, core.motion
    assert tested is not None
    assert used is not None
    onsets = [entry.onset_us for entry in core.excluded.values()]
    slow = outcome.slow
    hypothesis = "satellites" if late and outcome.hypothesis == "none" else outcome.hypothesis
    return Decision(
        t_s=epoch.t_us * 1e-6,
        t_us=epoch.t_us,
        statistic=tested.statistic,
        threshold=tested.threshold,
        dof=len(outcome.names),
        p_value=p_value(tested.statistic, len(outcome.names)),
        alarm=outcome.alarm or late,
        hypothesis=hypothesis,
        excluded=tuple(sorted(core.excluded)),
        satellites=outcome.names,
        residual_m=tuple(used.v_m.tolist()),
        normalised=tuple(tested.normalised.tolist()),
        onset_s=max(onsets) * 1e-6 if onsets else None,
        probabilities=tested.probabilities,
        position_ecef_m=_triple(motion.x) if motion is not None else None,
        position_sigma_m=_triple(np.sqrt(np.diag(motion.p))) if motion is not None else None,
        mode="inertial" if motion is not None and motion.inertial else "free",
        parity_statistic=outcome.parity[0],
        parity_threshold=outcome.parity[1],
        parity_dof=outcome.parity[2],
        slow_statistic=slow.statistic if slow is not None else None,
        slow_threshold=slow.threshold if slow is not None else None,
    )


def started(epoch: Epoch, observed: Observed, begun: Start, core: Core) -> Decision:
    """The decision on the epoch the filter started with."""
    motion = begun.motion
    assert motion is not None
    return Decision(
        t_s=epoch.t_us * 1e-6,
        t_us=epoch.t_us,
        statistic=begun.statistic,
        threshold=begun.threshold,
        dof=begun.dof,
        p_value=p_value(begun.statistic, begun.dof),
        alarm=bool(begun.left_out),
        hypothesis="satellites" if core.excluded else "none",
        excluded=tuple(sorted(core.excluded)),
        satellites=observed.satellites,
        position_ecef_m=_triple(motion.x),
        position_sigma_m=_triple(np.sqrt(np.diag(motion.p))),
        mode="start",
    )


def untestable(epoch: Epoch, reason: str, core: Core) -> Decision:
    """No decision, and why."""
    return Decision(
        t_s=epoch.t_us * 1e-6,
        t_us=epoch.t_us,
        statistic=None,
        threshold=None,
        dof=0,
        p_value=None,
        alarm=False,
        hypothesis="untestable",
        excluded=tuple(sorted(core.excluded)),
        reason=reason,
    )


def imu_results(
    epoch: Epoch, outcome: Outcome, part: Segment, config: DetectorConfig
) -> list[Result]:
    """What the epoch says of the IMU: silence, and the test of the velocity it predicts."""
    rates = outcome.rates
    if not outcome.was_inertial or rates is None:
        return []
    silent = part.gap_s > config.gap_s
    if not silent and rates.statistic is None and not outcome.imu_blamed:
        return []
    faulty = silent or outcome.imu_blamed
    return [
        SensorDecision(
            t_s=epoch.t_us * 1e-6,
            t_us=epoch.t_us,
            sensor="imu",
            statistic=rates.statistic,
            threshold=rates.threshold,
            dof=rates.dof,
            alarm=faulty,
            isolated=faulty,
            reason=f"no IMU samples for {part.gap_s:.2f} s" if silent else "",
        )
    ]


def _triple(values: Vector) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
