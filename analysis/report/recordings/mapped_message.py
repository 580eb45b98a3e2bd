"""Add what the field map says of one message to the data of a flight: curves, tracks, flags
and states."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from analysis.field_maps.field_map import (
    FLAGS,
    NOTHING,
    STATE,
    STATES,
    TRACK,
    MapLine,
    evaluate,
    rows_of,
    values_of,
)
from analysis.report.curves.recording import (
    Event,
    FlightData,
    GroundTrack,
    Message,
    Signal,
    Span,
    flag_events,
    value_spans,
)

REJECTED_S = 1.0  # chosen: single measurements are rejected in nominal flights too
GATE = "gate"  # names of gates begin with this; they have a curve below zero too
# Beginning and severity of the events of some lanes.
SAID = {"mode": ("mode ", 6), "estimator in use": ("estimator: ", 4)}


def add_message(
    found: FlightData,
    lines: Iterable[MapLine],
    message: Message,
    suffix: str = "",
    constants: Mapping[str, Any] = NOTHING,
) -> None:
    """Add the curves, tracks and flags of a message; `suffix` names its instance or system."""
    for line in lines:
        if line.target in STATES:
            _add_state(found, line, message, suffix, constants)
        elif line.target == TRACK:
            _add_track(found, line, message, suffix)
        elif line.target[0].islower():
            values = values_of(line, message.columns, constants)
            if values is not None and line.target in FLAGS:
                add_flag(found, line.target, line.name, message, values > 0, suffix)
            elif values is not None:
                found.signals.append(Signal(line.target, line.name + suffix, message.t_s, values))
                if line.name.startswith(GATE):
                    below = Signal(line.target, f"{line.name}, below", message.t_s, -values)
                    found.signals.append(below)


def add_flag(
    found: FlightData,
    kind: str,
    text: str,
    message: Message,
    raised: np.typing.NDArray[np.bool_],
    suffix: str = "",
) -> None:
    """Add the spans and events of a flag that is `raised` (n,) in the rows of a message."""
    # A flag that PX4 raises all the time is due to the configuration.
    if kind != "rejected" and found.autopilot == "px4" and not found.systems and raised.all():
        return
    lane = f"{'failsafe' if kind == 'failsafe' else 'estimator'}{suffix}: {text}"
    # A failed GPS quality check is a warning: the estimator continues without GPS.
    shown = "warn" if kind == "warn" else "flag"
    least_s = REJECTED_S if kind == "rejected" else 0.0
    spans = value_spans(lane, message.t_s, np.where(raised, text, ""), shown, least_s)
    found.spans.extend(spans)
    found.events.extend(flag_events(spans, float(message.t_s[-1])))


def _add_state(
    found: FlightData, line: MapLine, message: Message, suffix: str, constants: Mapping[str, Any]
) -> None:
    """Add the spans of a state; the last one lasts until the end of the log."""
    words, lane = evaluate(line.value, message.columns, constants), line.name + suffix
    known = line.target == STATE and any(span.lane == lane for span in found.spans)
    if words is not None and len(words) and not known:
        # Of several messages that say it, the first counts.
        t_s = np.append(message.t_s, max(found.duration_s, float(message.t_s[-1])))
        spans = value_spans(lane, t_s, [*words, words[-1]], STATES[line.target])
        found.spans.extend(spans)
        found.events.extend(flag_events(spans, float(t_s[-1])))


def mode_events(spans: Sequence[Span]) -> list[Event]:
    """The events of changes of state; the first span of a lane is its initial state."""
    found, lanes = [], set()
    for span in spans:
        if span.kind == "mode" and span.lane in lanes:
            # Of several vehicles the system stands behind the lane's name.
            lane, bracket, system = span.lane.partition(" (")
            word, severity = SAID.get(lane, ("", 6))
            text = f"{word}{span.text}{bracket}{system}"
            found.append(Event(span.start_s, "mode", text, severity))
        lanes.add(span.lane)
    return found


def _add_track(found: FlightData, line: MapLine, message: Message, suffix: str) -> None:
    rows = rows_of(line, message.columns)
    if rows is None:
        return
    # 0, 0 means no position.
    keep = np.isfinite(rows[:, :2]).all(axis=1) & rows[:, :2].any(axis=1)
    if keep.sum() > 1:
        lat, lon, alt = rows[keep].T
        found.tracks.append(GroundTrack(line.name + suffix, message.t_s[keep], lat, lon, alt))
