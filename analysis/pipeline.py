"""Samples to results: the only place where the steps are strung together, live and offline alike.

A step is a frozen set of parameters with `new_state()` and `step(sample, state)`, which gives back
results and the next state.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from analysis.attitude import AttitudeConfig, AttitudeScorer
from analysis.fdi import Detector, DetectorConfig
from analysis.reference import ReferenceConfig, References
from analysis.results import Result
from analysis.samples import EphemerisSample, IonosphereSample, Sample
from mavproxy_fault.errors import ConfigError
from mavproxy_fault.wire.label import Label

SECTIONS = ("attitude", "references")


class MonitorConfig(msgspec.Struct, frozen=True, kw_only=True):
    """What the monitor does: the detector, the checks of other sensors, the attitude scores."""

    detector: DetectorConfig = DetectorConfig()
    references: ReferenceConfig = ReferenceConfig()
    attitude: AttitudeConfig = AttitudeConfig()


def monitor_config(values: Mapping[str, Any] | None, where: str) -> MonitorConfig:
    """The `monitor` section of a scenario: the detector's keys, and a mapping per other step.

    Raises
    ------
    ConfigError
        For a name or value that is not allowed.
    """
    rest = dict(values or {})
    parts = {name: rest.pop(name) for name in SECTIONS if name in rest}
    try:
        return MonitorConfig(
            detector=DetectorConfig.from_mapping(rest),
            references=msgspec.convert(parts.get("references", {}), ReferenceConfig),
            attitude=msgspec.convert(parts.get("attitude", {}), AttitudeConfig),
        )
    except msgspec.ValidationError as error:
        raise ConfigError(f"{where}: monitor: {error}") from error


class Pipeline:
    """The steps and their states; times in results count from the first stamped sample."""

    def __init__(self, config: MonitorConfig) -> None:
        self._attitude = AttitudeScorer(config.attitude)
        self._attitude_state = self._attitude.new_state()
        self._steps: list[Any] = [Detector(config.detector), References(config.references)]
        self._states = [step.new_state() for step in self._steps]
        self._t0_us: int | None = None

    def push(self, sample: Sample) -> list[Result]:
        """What one sample leads to."""
        if self._t0_us is None and not isinstance(sample, (EphemerisSample, IonosphereSample)):
            self._t0_us = sample.t_us
        results: list[Result] = []
        for number, step in enumerate(self._steps):
            found, self._states[number] = step.step(sample, self._states[number])
            results += found
        scores, self._attitude_state = self._attitude.step(sample, self._attitude_state)
        results += scores
        base_us = self._t0_us or 0
        return [msgspec.structs.replace(r, t_s=(r.t_us - base_us) * 1e-6) for r in results]

    def attitude(self, labels: Sequence[Label] = ()) -> dict[str, Any]:
        """Scores by estimator."""
        return self._attitude.summary(self._attitude_state, labels)
