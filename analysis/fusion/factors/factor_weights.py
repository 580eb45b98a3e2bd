"""Weights of measurements from detector decisions: 1 healthy, less between thresholds, 0
isolated."""

import math
from collections.abc import Iterable, Sequence

from analysis.fusion.fusion_config import FusionConfig
from analysis.results import Decision, Result, SensorDecision

USABLE_HYPOTHESES = ("none", "satellites", "clock", "gps", "imu")
DEWEIGHT_FROM = 0.7  # of the root of a sensor's threshold: the weight falls from 1 here to 0 at 1


def residual_weight(normalised: float, suspicious: float, hopeless: float) -> float:
    """s(r) of a normalised residual: 1 up to `suspicious`, 0 from `hopeless`.

    Between them 1 - 3 u^2 + 2 u^3 with u from 0 to 1, so that neither the weight nor its slope
    jumps.
    """
    u = (abs(normalised) - suspicious) / (hopeless - suspicious)
    u = min(max(u, 0.0), 1.0)
    return 1.0 - u * u * (3.0 - 2.0 * u)


def range_weights(decision: Decision, config: FusionConfig) -> dict[str, float]:
    """Weights of the satellites the detector tested at one epoch.

    All weights are 0 where the detector could not isolate the fault. The residuals are those before
    isolation, so that with an isolated satellite they are not used for the others.
    """
    if not config.decide:
        return dict.fromkeys((*decision.satellites, *decision.excluded), 1.0)
    if decision.hypothesis not in USABLE_HYPOTHESES:
        return dict.fromkeys(decision.satellites, 0.0)
    # Also without an alarm: the hypothesis says that isolation failed.
    weights = dict.fromkeys(decision.satellites, 1.0)
    if not decision.alarm and decision.hypothesis in ("none", "satellites"):
        for name, value in zip(decision.satellites, decision.normalised, strict=False):
            # An unknown residual counts as hopeless.
            residual = float("inf") if value is None else value
            if not abs(residual) <= config.suspicious:
                weights[name] = residual_weight(residual, config.suspicious, config.hopeless)
    weights.update(dict.fromkeys(decision.excluded, 0.0))
    return weights


def faulty_rates(results: Sequence[Result]) -> frozenset[str]:
    """Satellites with a faulty Doppler rate but no faulty range at this epoch."""
    return frozenset(
        result.suspect
        for result in results
        if isinstance(result, SensorDecision) and result.sensor == "satellites" and result.suspect
    )


def sensor_weights(
    results: Sequence[Result], isolated: Iterable[str], config: FusionConfig
) -> dict[str, float]:
    """Weights of sensors other than satellites that were tested or isolated at this epoch."""
    if not config.decide:
        return {}
    weights = {}
    for result in results:
        if isinstance(result, SensorDecision) and result.statistic is not None and result.threshold:
            weights[result.sensor] = residual_weight(
                # The root, since statistics are squares of normalised residuals.
                math.sqrt(result.statistic / result.threshold),
                DEWEIGHT_FROM,
                1.0,
            )
    # Isolated sensors last: they have no weight, whatever their statistic.
    return weights | dict.fromkeys(isolated, 0.0)


def isolated_sensors(results: Sequence[Result], config: FusionConfig) -> frozenset[str]:
    """Sensors other than satellites that must not be used at this epoch."""
    if not config.decide:
        return frozenset()
    return frozenset(
        result.sensor
        for result in results
        if isinstance(result, SensorDecision) and (result.isolated or result.alarm)
    )
