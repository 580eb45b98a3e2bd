"""An ArduPilot dataflash log to a `Recording`.

Messages and fields as ArduPilot's log reference names them (old logs: as they were named then).
"""

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.dataflash import DataflashFile, Topic
from analysis.report.recordings.dataflash_curves import CURVES
from analysis.report.recordings.mode_names import (
    ARDUPILOT,
    ERRORS,
    EVENTS,
    FIXED_WING,
    ROVERS,
    mode_name,
)
from analysis.report.recordings.recording import (
    UNGRADED,
    Event,
    Recording,
    Signal,
    Span,
    Track,
    Vector,
    runs,
)

ARMED, DISARMED = 10, 11  # EV.Id
COPTER = 2  # MAV_TYPE of a quadrotor
NOT_YET = 3  # severity of an error
TIMEOUTS = {0: "position timeout", 1: "velocity timeout", 2: "height timeout", 3: "compass timeout"}
ESTIMATORS = ("XKF4", "NKF4", "EKF4")


def recording_of_dataflash(log: DataflashFile, name: str, t0_us: int | None = None) -> Recording:
    """Everything of a dataflash log that a report shows; `t0_us` or its beginning is zero."""
    start_us = log.start_us if t0_us is None else t0_us
    found = Recording(name, "ardupilot", start_us, (log.end_us - start_us) * 1e-6)
    for (kind, instance), topic in sorted(log.topics.items()):
        t_s = _seconds(topic, start_us)
        suffix = f" {instance + 1}" if instance else ""
        for message, panel, label, values, every in CURVES:
            if message == kind and (every or instance == 0):
                y = values(topic)
                if y is not None and np.isfinite(y).any():
                    found.signals.append(Signal(panel, label + suffix, t_s, y))
        found.tracks.extend(_tracks(kind, suffix, topic, t_s))
    _add_modes(found, log, start_us)
    _add_armed(found, log, start_us)
    _add_timeouts(found, log, start_us)
    _add_said(found, log, start_us)
    _add_parameters(found, log, start_us)
    found.events.sort(key=lambda event: event.t_s)
    if log.cut:
        found.notes.append("the file ends in the middle of a message: it was cut short")
    if log.damaged:
        found.notes.append("parts of the file are damaged and were passed over")
    if log.left_out:
        found.notes.append(
            f"the file is large: its last {log.left_out / 1e6:.0f} MB were not read, the report "
            "covers the beginning"
        )
    return found


def _seconds(topic: Topic, start_us: int) -> Vector:
    return np.asarray((topic["TimeUS"] - start_us) * 1e-6, float)


def _text(value: object) -> str:
    return value.decode("utf-8", "replace").strip() if isinstance(value, bytes) else str(value)


def _tracks(kind: str, suffix: str, topic: Topic, t_s: Vector) -> list[Track]:
    label = {"GPS": "GPS", "POS": "estimate"}.get(kind)
    if label is None or not {"Lat", "Lng", "Alt"} <= topic.keys():
        return []
    keep = topic["Lat"] != 0
    if keep.sum() < 2:
        return []
    columns = [topic[key][keep].astype(float) for key in ("Lat", "Lng", "Alt")]
    return [Track(label + suffix, t_s[keep], *columns)]


def _add_modes(found: Recording, log: DataflashFile, start_us: int) -> None:
    topic = log.topics.get(("MODE", 0))
    if topic is None:
        return
    said = " ".join(_text(text) for text in log.topics.get(("MSG", 0), {}).get("Message", [])[:20])
    vehicle = FIXED_WING if "Plane" in said else ROVERS[0] if "Rover" in said else COPTER
    t_s = [*_seconds(topic, start_us).tolist(), found.duration_s]
    numbers = topic.get("ModeNum", topic.get("Mode", np.empty(0)))
    for i, number in enumerate(numbers.tolist()):
        text = mode_name(ARDUPILOT, vehicle, int(number))
        found.spans.append(Span("mode", t_s[i], t_s[i + 1], text, "mode"))
        found.events.append(Event(t_s[i], "mode", f"mode {text}"))


def _add_armed(found: Recording, log: DataflashFile, start_us: int) -> None:
    """Stretches between arming and disarming; a log may begin or end in flight."""
    topic = log.topics.get(("EV", 0))
    if topic is None:
        return
    since: float | None = None
    first = True
    for t_s, number in zip(_seconds(topic, start_us).tolist(), topic["Id"].tolist(), strict=True):
        if number in EVENTS:
            found.events.append(Event(t_s, "mode", EVENTS[number]))
        if number == ARMED and since is None:
            since = t_s
        if number == DISARMED and (since is not None or first):
            found.spans.append(Span("armed", since or 0.0, t_s, "armed", "mode"))
            since = None
        first &= number not in (ARMED, DISARMED)
    if since is not None:
        found.spans.append(Span("armed", since, found.duration_s, "armed", "mode"))


def _add_timeouts(found: Recording, log: DataflashFile, start_us: int) -> None:
    """Sensors that the estimator says it has not used for too long."""
    topic = next((t for k in ESTIMATORS if (t := log.topics.get((k, 0))) and "TS" in t), None)
    if topic is None:
        return
    t_s = _seconds(topic, start_us)
    flags: NDArray[np.int64] = topic["TS"].astype(np.int64)
    for bit, text in TIMEOUTS.items():
        for begin, end in runs(flags >> bit & 1 == 1):
            lane = f"estimator: {text}"
            stop = float(t_s[min(end, len(t_s) - 1)])
            found.spans.append(Span(lane, float(t_s[begin]), stop, text, "flag"))
            found.events.append(Event(float(t_s[begin]), "flag", f"{lane} raised", 4))


def _add_said(found: Recording, log: DataflashFile, start_us: int) -> None:
    """Texts and errors."""
    if (topic := log.topics.get(("MSG", 0))) is not None:
        for t_s, text in zip(_seconds(topic, start_us).tolist(), topic["Message"], strict=True):
            found.events.append(Event(t_s, "text", _text(text), UNGRADED))
    if (topic := log.topics.get(("ERR", 0))) is not None:
        rows = zip(_seconds(topic, start_us).tolist(), topic["Subsys"], topic["ECode"], strict=True)
        for t_s, subsystem, code in rows:
            name = ERRORS.get(int(subsystem), f"subsystem {subsystem}")
            text = f"{name}: error {code}" if code else f"{name}: resolved"
            found.events.append(Event(t_s, "error", text, NOT_YET if code else 6))


def _add_parameters(found: Recording, log: DataflashFile, start_us: int) -> None:
    topic = log.topics.get(("PARM", 0))
    if topic is None:
        return
    rows = zip(_seconds(topic, start_us).tolist(), topic["Name"], topic["Value"], strict=True)
    for t_s, name, value in rows:
        history = found.parameters.setdefault(_text(name), [])
        if not history or history[-1][1] != float(value):
            history.append((t_s, float(value)))
