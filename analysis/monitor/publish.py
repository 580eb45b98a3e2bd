"""Publishes results on Zenoh: one key per kind of result; events are kept for late joiners."""

from collections.abc import Iterable

from analysis.results import AttitudeError, Decision, FusedState, Result, SensorDecision, encode
from mavproxy_fault.links.bus import Bus

SCHEMA = "mavfault.v1"
EVENTS_KEPT = 100  # for late subscribers: a page shows fewer


def result_key(result: Result) -> str:
    """The key of a result below the run's prefix."""
    match result:
        case Decision():
            return "fdi/main/stat"
        case SensorDecision():
            return f"fdi/{result.sensor}/stat"
        case AttitudeError():
            return f"att/{result.estimator}/score"
        case FusedState():
            return "fusion/state" if result.name == "fused" else "fusion/without-isolation"


class Publisher:
    """Publishes every result; changes of a verdict also go to the keys for events."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._verdicts: dict[str, tuple[object, ...]] = {}
        self._excluded: tuple[str, ...] | None = None

    def publish(self, results: Iterable[Result]) -> None:
        """Publish results in order."""
        for result in results:
            key, data = result_key(result), encode(result)
            self._bus.put(key, data, f"{SCHEMA}.{type(result).__name__}")
            # Each change of the exclusions is published once, whatever the verdict.
            if isinstance(result, Decision) and result.excluded != self._excluded:
                self._excluded = result.excluded
                # The last one is kept: late joiners need the present exclusions.
                self._bus.put("fdi/isolation", data, f"{SCHEMA}.Decision", history=1)
            if self._changed(key, result):
                schema = f"{SCHEMA}.{type(result).__name__}"
                self._bus.put("fdi/events", data, schema, history=EVENTS_KEPT)

    def _changed(self, key: str, result: Result) -> bool:
        match result:
            case Decision():
                verdict: tuple[object, ...] = (result.alarm, result.hypothesis, result.excluded)
            case SensorDecision(statistic=None, alarm=False, isolated=False):
                return False  # not tested
            case SensorDecision():
                verdict = (result.alarm, result.isolated)
                key += "" if result.dof else "/stream"  # its samples have a verdict of their own
            case _:
                return False
        before = self._verdicts.get(key)
        self._verdicts[key] = verdict
        return before != verdict
