"""Convert fault labels and monitor results to `FlightData`."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from analysis.report.curves.fused_curves import AXES, FUSED
from analysis.report.curves.recording import (
    Event,
    FlightData,
    GroundTrack,
    Signal,
    Span,
    true_runs,
    value_spans,
)
from analysis.results import FOREVER_US, AttitudeError, Decision, FusedState, Result, SensorDecision
from analysis.scoring.outcome import RECOVERY_S
from mavproxy_fault.numerics import earth
from mavproxy_fault.wire.label import Label

RECOVERY_ROW = f"{RECOVERY_S:g} s after a fault"
EVERY_EPOCH = {"fdi-residual", "fdi-normalised", "fdi-probability"}
SOLUTION = "GNSS solution"  # track of the positions from ranges
TEXTS_SHOWN = 4  # of an alarm, for lack of space


def axis_start(labels: Sequence[Label], results: Sequence[Result]) -> int | None:
    """Vehicle time of zero on the axis: the start of the schedule, else the first result."""
    if labels:
        return labels[0].t0_us
    return results[0].t_us if results else None


def recording_of_results(
    labels: Sequence[Label], results: Iterable[Result], t0_us: int
) -> FlightData:
    """Convert labels and results to curves, spans and events on the axis that starts at `t0_us`."""
    # Results may be out of order.
    results = sorted(results, key=lambda result: result.t_us)
    found = FlightData("results", t0_us=t0_us)
    for label in labels:
        found.spans.append(_injected(label, results, t0_us))
        began_s, text = (label.start_us - t0_us) * 1e-6, f"{label.id}: {label.fault} begins"
        found.events.append(Event(began_s, "fault", text, 4))
    points: dict[tuple[str, str], list[tuple[float, float | None]]] = defaultdict(list)
    alarms: dict[str, list[tuple[float, bool, str]]] = defaultdict(list)
    places: dict[str, list[tuple[float, Sequence[float]]]] = defaultdict(list, {SOLUTION: []})
    excluded: dict[str, list[float]] = defaultdict(list)
    for result in results:
        t_s = (result.t_us - t0_us) * 1e-6
        for panel, name, value in _values(result):
            points[panel, name].append((t_s, value))
        if isinstance(result, Decision):
            alarms["detected: GNSS"].append((t_s, result.alarm, _verdict(result)))
            for satellite in result.excluded:
                excluded[satellite].append(t_s)
            if result.position_ecef_m is not None:
                places[SOLUTION].append((t_s, result.position_ecef_m))
        elif isinstance(result, SensorDecision):
            alarms[f"detected: {result.sensor}"].append((t_s, result.alarm, result.sensor))
        elif isinstance(result, FusedState):
            places[result.name].append((t_s, result.position_ecef_m))
            if result.reason:  # a start, a failure, late data
                text = f"{result.name}: {result.reason}"
                found.events.append(Event(t_s, "fusion", text, 4))
    epochs = np.unique([t_s for t_s, *_ in alarms.get("detected: GNSS", ())])
    for (panel, name), rows in points.items():
        times, values = np.array(rows, float).T
        if panel in EVERY_EPOCH:
            # NaN where an epoch has no value.
            every = np.full(len(epochs), np.nan)
            every[np.searchsorted(epochs, times)] = values
            times, values = epochs, every
        found.signals.append(Signal(panel, name, times, values))
    for lane, alarm_rows in alarms.items():
        found.spans.extend(_alarm_spans(lane, alarm_rows))
    for satellite, out in sorted(excluded.items()):
        words = np.where(np.isin(epochs, out), f"{satellite} excluded", "")
        found.spans.extend(value_spans(f"excluded: {satellite}", epochs, words, "detected"))
    for name, track in places.items():
        if len(track) > 1:
            lat, lon, height = earth.geodetic_from_ecef(np.array([place for _, place in track]))
            times = np.array([t_s for t_s, _ in track])
            found.tracks.append(GroundTrack(name, times, np.degrees(lat), np.degrees(lon), height))
    return found


def _injected(label: Label, results: Sequence[Result], t0_us: int) -> Span:
    # A fault without end lasts until the last result.
    last_us = results[-1].t_us if results else label.start_us
    end_us = last_us if label.end_us is None else label.end_us
    text = f"{label.preset or label.fault} on {label.describe_target()}"
    if label.by:
        text = f"{label.fault} by the {label.by} itself"
    begin_s, end_s = ((t_us - t0_us) * 1e-6 for t_us in (label.start_us, end_us))
    return Span(f"injected: {label.id}", begin_s, end_s, text, "injected")


def _verdict(decision: Decision) -> str:
    return " ".join((decision.hypothesis, *decision.excluded))


def _values(result: Result) -> Iterator[tuple[str, str, float | None]]:
    """Panel, name and value of every curve that a result has a point of."""
    if isinstance(result, Decision):
        yield "fdi-statistic", "statistic", result.statistic
        yield "fdi-statistic", "threshold", result.threshold
        ranges = {"fdi-residual": result.residual_m, "fdi-normalised": result.normalised}
        for panel, values in ranges.items():
            # `zip` stops at the shorter one: residuals may be omitted.
            for name, value in zip(result.satellites, values, strict=False):
                yield panel, name, value
        for name, probability in result.probabilities.items():
            yield "fdi-probability", name, probability
    elif isinstance(result, SensorDecision):
        # Relative to the threshold, so that all sensors share one plot.
        if result.statistic is not None and result.threshold:
            yield "fdi-sensor", result.sensor, result.statistic / result.threshold
    elif isinstance(result, AttitudeError):
        for part in ("roll", "pitch", "yaw", "angle"):
            yield f"error-{part}", result.estimator, getattr(result, part)
    elif result.name == FUSED:
        for axis, sigma in zip(AXES, result.position_sigma_m, strict=True):
            yield "fused-sigma", axis, sigma
        for source, weight in result.weights.items():
            yield "fused-weight", source, weight


def _alarm_spans(lane: str, rows: Sequence[tuple[float, bool, str]]) -> Iterator[Span]:
    """Each alarm until the first row without one, with the texts of its rows."""
    for begin, end in true_runs(np.array([alarm for _, alarm, _ in rows])):
        texts = list(dict.fromkeys(text for _, _, text in rows[begin:end]))[:TEXTS_SHOWN]
        stop_s = rows[min(end, len(rows) - 1)][0]
        yield Span(lane, rows[begin][0], stop_s, "; ".join(texts), "detected")


def isolation_matrix(
    labels: Sequence[Label], results: Iterable[Result]
) -> tuple[list[str], dict[str, list[int]]]:
    """Isolation matrix: number of epochs by injected fault (or none) and decision.

    The decisions (columns), and for each fault one count per decision.
    """
    rows = [*(label.id for label in labels), RECOVERY_ROW, "no fault"]
    counts: dict[str, Counter[str]] = {row: Counter() for row in rows}
    for result in results:
        if not isinstance(result, Decision):
            continue
        t_us = result.t_us
        true = [label.id for label in labels if label.start_us <= t_us <= _end_us(label)]
        # After a fault its exclusions rightly persist for a while.
        after = any(0 < t_us - _end_us(label) <= RECOVERY_S * 1e6 for label in labels)
        for row in true or [RECOVERY_ROW if after else "no fault"]:
            # The excluded satellites; without any, the hypothesis.
            counts[row].update(result.excluded or (result.hypothesis,))
    if not counts[RECOVERY_ROW]:
        del counts[RECOVERY_ROW]
    heads = sorted({column for row in counts.values() for column in row}, key=_rank)
    return heads, {row: [counts[row][head] for head in heads] for row in counts}


def _end_us(label: Label) -> int:
    return FOREVER_US if label.end_us is None else label.end_us


def _rank(name: str) -> tuple[int, str]:
    """Sort key: "none" first, satellites last."""
    order = ("none", "imu", "GPS-or-imu", "clock", "multiple-unknown", "untestable")
    return (order.index(name), "") if name in order else (len(order), name)
