"""Convert fault labels and monitor results to `FlightData`."""

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from analysis.report.curves.recording import (
    Event,
    FlightData,
    GroundTrack,
    Signal,
    Span,
    Vector,
    true_runs,
)
from analysis.results import AttitudeError, Decision, FusedState, Result, SensorDecision
from analysis.scoring.outcome import RECOVERY_S
from mavproxy_fault.numerics import earth
from mavproxy_fault.wire.label import Label

RECOVERY_ROW = f"{RECOVERY_S:g} s after one"
EVERY_EPOCH = {"fdi-residual", "fdi-normalised", "fdi-probability"}
Points = dict[tuple[str, str], list[tuple[float, float]]]


def axis_start(labels: Sequence[Label], results: Sequence[Result]) -> int | None:
    """Vehicle time of zero on the axis: the start of the schedule, else the first result."""
    if labels:
        return labels[0].t0_us
    return results[0].t_us if results else None


def recording_of_results(
    labels: Sequence[Label], results: Iterable[Result], t0_us: int
) -> FlightData:
    """Convert labels and results to curves, spans and events on the axis that starts at `t0_us`."""
    # Iterated twice.
    results = list(results)
    found = FlightData("results", t0_us=t0_us)
    for label in labels:
        found.spans.append(_injected(label, results, t0_us))
        found.events.append(
            Event((label.start_us - t0_us) * 1e-6, "fault", f"{label.id}: {label.fault} begins", 4)
        )
    points: Points = defaultdict(list)
    alarms: dict[str, list[tuple[float, bool, str]]] = defaultdict(list)
    fused: dict[str, list[tuple[float, tuple[float, float, float]]]] = defaultdict(list)
    solved: list[tuple[float, tuple[float, float, float]]] = []
    excluded: dict[str, list[float]] = defaultdict(list)
    epochs: list[float] = []
    for result in results:
        t_s = (result.t_us - t0_us) * 1e-6
        if isinstance(result, Decision):
            _decision(result, t_s, points)
            alarms["detected: GNSS"].append((t_s, result.alarm, _verdict(result)))
            epochs.append(t_s)
            for satellite in result.excluded:
                excluded[satellite].append(t_s)
            if result.position_ecef_m is not None:
                solved.append((t_s, result.position_ecef_m))
        elif isinstance(result, SensorDecision):
            # Relative to the threshold, so that all sensors share one plot.
            if result.statistic is not None and result.threshold:
                points["fdi-sensor", result.sensor].append(
                    (t_s, result.statistic / result.threshold)
                )
            alarms[f"detected: {result.sensor}"].append((t_s, result.alarm, result.sensor))
        elif isinstance(result, AttitudeError):
            for part in ("roll", "pitch", "yaw", "angle"):
                points[f"error-{part}", result.estimator].append((t_s, getattr(result, part)))
        else:
            _fused(result, t_s, points)
            fused[result.name].append((t_s, result.position_ecef_m))
            if result.reason:  # a start, a failure, late data
                text = f"{result.name}: {result.reason}"
                found.events.append(Event(t_s, "fusion", text, 4))
    for (panel, name), values in points.items():
        every = epochs if panel in EVERY_EPOCH else ()
        found.signals.append(_signal(panel, name, values, every))
    for lane, rows in alarms.items():
        found.spans.extend(_alarm_spans(lane, rows))
    found.spans.extend(_excluded_spans(excluded, epochs))
    for name, track in (("GNSS solution", solved), *fused.items()):
        if len(track) > 1:
            found.tracks.append(_track(name, track))
    return found


def _injected(label: Label, results: Sequence[Result], t0_us: int) -> Span:
    end_us = label.end_us
    if end_us is None:
        # A fault without end lasts until the last result.
        end_us = max((result.t_us for result in results), default=label.start_us)
    text = f"{label.preset or label.fault} on {', '.join(label.targets) or 'the link'}"
    if label.by:
        text = f"{label.fault} by the {label.by} itself"
    return Span(
        f"injected: {label.id}",
        (label.start_us - t0_us) * 1e-6,
        (end_us - t0_us) * 1e-6,
        text,
        "injected",
    )


def _verdict(decision: Decision) -> str:
    names = " ".join(decision.excluded)
    return f"{decision.hypothesis} {names}".strip()


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _decision(decision: Decision, t_s: float, points: Points) -> None:
    points["fdi-statistic", "statistic"].append((t_s, _number(decision.statistic)))
    points["fdi-statistic", "threshold"].append((t_s, _number(decision.threshold)))
    # `zip` stops at the shorter one: residuals may be omitted.
    for name, value in zip(decision.satellites, decision.residual_m, strict=False):
        points["fdi-residual", name].append((t_s, _number(value)))
    for name, value in zip(decision.satellites, decision.normalised, strict=False):
        points["fdi-normalised", name].append((t_s, _number(value)))
    for name, probability in decision.probabilities.items():
        points["fdi-probability", name].append((t_s, probability))


def _fused(state: FusedState, t_s: float, points: Points) -> None:
    if state.name != "fused":
        return
    for axis, sigma in zip(("north", "east", "down"), state.position_sigma_m, strict=True):
        points["fused-sigma", axis].append((t_s, sigma))
    for source, weight in state.weights.items():
        points["fused-weight", source].append((t_s, weight))


def _signal(
    panel: str, name: str, rows: list[tuple[float, float]], every: Sequence[float]
) -> Signal:
    """A curve; with `every`, at all these times, NaN where there is no row."""
    # Rows may be out of order.
    t_s, value = np.array(sorted(rows, key=lambda row: row[0]), float).T
    if not every:
        return Signal(panel, name, t_s, value)
    times = np.unique(every)
    values = np.full(len(times), np.nan)
    values[np.searchsorted(times, t_s)] = value
    return Signal(panel, name, times, values)


def _track(name: str, rows: list[tuple[float, tuple[float, float, float]]]) -> GroundTrack:
    rows.sort(key=lambda row: row[0])
    lat, lon, height = earth.geodetic_from_ecef(np.array([row[1] for row in rows]))
    t_s = np.array([row[0] for row in rows])
    return GroundTrack(name, t_s, np.degrees(lat), np.degrees(lon), height)


def _alarm_spans(lane: str, rows: list[tuple[float, bool, str]]) -> list[Span]:
    rows.sort(key=lambda row: row[0])
    t_s: Vector = np.array([row[0] for row in rows])
    spans = []
    for begin, end in true_runs(np.array([row[1] for row in rows])):
        # Each text once, and at most four, for lack of space.
        texts = list(dict.fromkeys(row[2] for row in rows[begin:end]))
        stop = t_s[min(end, len(t_s) - 1)]
        # Until the first row without alarm.
        spans.append(Span(lane, float(t_s[begin]), float(stop), "; ".join(texts[:4]), "detected"))
    return spans


def _excluded_spans(excluded: dict[str, list[float]], epochs: list[float]) -> list[Span]:
    """Spans in which each satellite was excluded, one lane per satellite."""
    times = np.array(sorted(epochs))
    spans = []
    for satellite, out in sorted(excluded.items()):
        for begin, end in true_runs(np.isin(times, out)):
            stop = float(times[min(end, len(times) - 1)])
            text = f"{satellite} excluded"
            spans.append(
                Span(f"excluded: {satellite}", float(times[begin]), stop, text, "detected")
            )
    return spans


def isolation_matrix(
    labels: Sequence[Label], results: Iterable[Result]
) -> tuple[list[str], dict[str, list[int]]]:
    """Isolation matrix: number of epochs by injected fault (or none) and decision.

    Returns
    -------
    tuple
        The decisions (columns), and for each fault one count per decision.
    """
    rows = [label.id for label in labels] + [RECOVERY_ROW, "no fault"]
    counts: dict[str, dict[str, int]] = {row: defaultdict(int) for row in rows}
    for result in results:
        if not isinstance(result, Decision):
            continue
        # The excluded satellites; without any, the hypothesis.
        decided = result.excluded or (result.hypothesis,)
        true = [
            label.id
            for label in labels
            if label.start_us <= result.t_us
            and (label.end_us is None or result.t_us <= label.end_us)
        ]
        # After a fault its exclusions rightly persist for a while.
        true = true or [RECOVERY_ROW if _just_after(labels, result.t_us) else "no fault"]
        for row in true:
            for column in decided:
                counts[row][column] += 1
    if not counts[RECOVERY_ROW]:
        del counts[RECOVERY_ROW]
    heads = sorted({column for row in counts.values() for column in row}, key=_rank)
    return heads, {row: [counts[row][head] for head in heads] for row in counts}


def _just_after(labels: Sequence[Label], t_us: int) -> bool:
    return any(
        label.end_us is not None and 0 < t_us - label.end_us <= RECOVERY_S * 1e6 for label in labels
    )


def _rank(name: str) -> tuple[int, str]:
    """Sort key: "none" first, satellites last."""
    order = ("none", "imu", "GPS-or-imu", "clock", "multiple-unknown", "untestable")
    return (order.index(name), "") if name in order else (len(order), name)
