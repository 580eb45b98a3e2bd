"""Convert an ArduPilot dataflash log to `FlightData`.

Messages and fields are named as in ArduPilot's log reference (old logs: as then).
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.field_maps.dataflash_map import DATAFLASH
from analysis.recordings.flight_logs.dataflash import DataflashFile, Topic
from analysis.report.curves.motor_outputs import outputs_by_function
from analysis.report.curves.recording import (
    UNGRADED,
    Event,
    FlightData,
    Message,
    Span,
    Vector,
    value_spans,
)
from analysis.report.curves.vehicle_phase import (
    ARDUPILOT,
    BUILDS,
    COPTER,
    class_by_texts,
    mode_name,
)
from analysis.report.recordings.event_names import ERRORS, EVENTS, FAILSAFE_REASONS
from analysis.report.recordings.mapped_message import add_message
from analysis.report.recordings.vehicle_identity import identity_by_messages

ARMED, DISARMED = 10, 11  # EV.Id
# EV.Id of events that occur once per flight and only while armed.
AUTO_ARMED, NOT_LANDED, MOTORS_ALLOWED = 15, 28, 57
LANDED = 18
ARMING_EVENTS = (ARMED, DISARMED, AUTO_ARMED, NOT_LANDED, MOTORS_ALLOWED)
# Fields that show states where events are missing: message, field, lane, texts of 0 and 1.
STATES = (
    ("ARM", "ArmState", "armed", ("disarmed", "armed")),
    ("STAT", "Armed", "armed", ("disarmed", "armed")),
    ("STAT", "isFlying", "flying", ("landed", "flying")),
)
PRE_ARM = re.compile(r"^Pre-?Arm:", re.IGNORECASE)  # sent while disarmed
FIRST_TEXTS = 40  # chosen: the firmware names itself among the first texts of a log
ERROR_SEVERITY = 3  # severity of an error
GPS_EPOCH_US = 315_964_800_000_000  # 6 January 1980 in Unix time
WEEK_US = 604_800_000_000
LEAP_US = 18_000_000  # GPS is ahead of UTC since 2017
LEAST_SPIN = 0.02  # chosen: MOT_SPIN_ARM is 0.1, a disarmed motor has no output
ESTIMATORS = ("XKF4", "NKF4", "EKF4")


def recording_of_dataflash(log: DataflashFile, name: str, t0_us: int | None = None) -> FlightData:
    """Convert a dataflash log; the time axis starts at `t0_us` or the log's start."""
    start_us = log.start_us if t0_us is None else t0_us
    end_s = (log.end_us - start_us) * 1e-6
    found = FlightData(name, "ardupilot", start_us, end_s, vehicle=_vehicle_class(log))
    for (kind, instance), topic in sorted(log.topics.items()):
        t_s = _seconds(topic, start_us)
        suffix = f" {instance + 1}" if instance else ""
        # Names in the page's expressions cannot contain spaces.
        message = found.messages[f"{kind}{suffix.replace(' ', '_')}"] = Message(t_s, topic)
        lines = [line for line in DATAFLASH.get(kind, ()) if not (line.first and instance)]
        add_message(found, lines, message, suffix)
    _add_modes(found, log, start_us)
    _add_armed(found, log, start_us)
    _add_core(found, log, start_us)
    _add_texts(found, log, start_us)
    refused = any(PRE_ARM.search(event.text) for event in found.events if event.kind == "text")
    if refused and not any(span.lane == "armed" for span in found.spans):
        found.spans.append(Span("armed", 0.0, end_s, "disarmed", "mode"))
    _add_parameters(found, log, start_us)
    _add_armed_by_motors(found)
    found.events.sort(key=lambda event: event.t_s)
    if log.cut:
        found.notes.append("the file ends within a message: the log is truncated")
    if log.corrupted:
        found.notes.append("parts of the file are corrupted and were skipped")
    found.notes.extend(log.times.notes())
    identity = identity_by_messages(found)
    return replace(found, utc0_us=_utc0_us(log, start_us), identity=identity)


def _topic(
    log: DataflashFile, name: str, numbers: Sequence[str] = (), texts: Sequence[str] = ()
) -> Topic | None:
    """A topic with these fields; None without them, as where a format is damaged."""
    topic = log.topics.get((name, 0), {})
    right = all(key in topic and topic[key].dtype.kind in "iuf" for key in numbers)
    right &= all(key in topic and topic[key].dtype.kind == "S" for key in texts)
    return topic if right else None


def _seconds(topic: Topic, start_us: int) -> Vector:
    return np.asarray((topic["TimeUS"] - start_us) * 1e-6, float)


def _text(value: object) -> str:
    return value.decode("utf-8", "replace").strip() if isinstance(value, bytes) else str(value)


def _vehicle_class(log: DataflashFile) -> str:
    """Class by the build (VER), or by the name of the firmware, which is among the first texts."""
    parameters = _topic(log, "PARM", numbers=("Value",), texts=("Name",)) or {}
    quad = [v for n, v in zip(parameters.get("Name", ()), parameters.get("Value", ()), strict=False)
            if _text(n) == "Q_ENABLE"]  # fmt: skip
    said = _topic(log, "MSG", texts=("Message",)) or {}
    texts = [_text(text) for text in said.get("Message", ())[:FIRST_TEXTS]]
    build = (_topic(log, "VER", numbers=("BU",)) or {"BU": np.zeros(1)})["BU"][0]
    known = class_by_texts(texts, {"Q_ENABLE": float(quad[-1]) if quad else 0.0})
    return known or BUILDS.get(int(build), "")


def _add_modes(found: FlightData, log: DataflashFile, start_us: int) -> None:
    topic = log.topics.get(("MODE", 0), {})
    key = next((k for k in ("ModeNum", "Mode") if k in topic and topic[k].dtype.kind in "iu"), None)
    if key is None:
        return
    # A mode lasts until the next one or the end.
    t_s = [*_seconds(topic, start_us).tolist(), found.duration_s]
    reasons = topic.get("Rsn")
    for i, number in enumerate(topic[key].tolist()):
        text = mode_name(ARDUPILOT, found.vehicle, int(number))
        found.spans.append(Span("mode", t_s[i], t_s[i + 1], text, "mode"))
        found.events.append(Event(t_s[i], "mode", f"mode {text}"))
        reason = int(reasons[i]) if reasons is not None and reasons.dtype.kind in "iu" else 0
        why = FAILSAFE_REASONS.get(reason)
        if reason:
            found.events.append(
                Event(t_s[i], "failsafe", why, 4) if why else Event(t_s[i], "command", text)
            )


def _add_armed(found: FlightData, log: DataflashFile, start_us: int) -> None:
    """Spans between arming and disarming, and in the air; a log may begin or end in flight."""
    for name, field, lane, texts in STATES:
        said = _topic(log, name, numbers=(field,))
        if said is not None and not any(span.lane == lane for span in found.spans):
            words = [texts[int(bool(state))] for state in said[field].tolist()]
            found.spans.extend(_lasting(lane, _seconds(said, start_us), words, found.duration_s))
    topic = _topic(log, "EV", numbers=("Id",))
    if topic is None or not np.isin(topic["Id"], ARMING_EVENTS).any():
        return
    found.spans[:] = [span for span in found.spans if span.lane != "armed"]
    air = np.isin(topic["Id"], (NOT_LANDED, LANDED, DISARMED))
    if np.any(topic["Id"] == NOT_LANDED):
        words = ["flying" if number == NOT_LANDED else "landed" for number in topic["Id"][air]]
        t_all_s = _seconds(topic, start_us)
        found.spans[:] = [span for span in found.spans if span.lane != "flying"]
        found.spans.extend(_lasting("flying", t_all_s[air], words, found.duration_s))
    since: float | None = None
    first, began = True, 0.0
    # A first disarming without arming: the log begins in flight, or the arming event is lost; then
    # an event that occurs once per flight gives the start.
    for t_s, number in zip(_seconds(topic, start_us).tolist(), topic["Id"].tolist(), strict=True):
        if number in EVENTS:
            found.events.append(Event(t_s, "mode", EVENTS[number]))
        if first and not began and number in (AUTO_ARMED, NOT_LANDED, MOTORS_ALLOWED):
            began = t_s
        if number == ARMED and since is None:
            since = t_s
        if number == DISARMED and (since is not None or first):
            found.spans.append(
                Span("armed", since if since is not None else began, t_s, "armed", "mode")
            )
            since = None
        first &= number not in (ARMED, DISARMED)
    # The arming event is lost, and the log ends in flight.
    if first and began:
        since = began
    if since is not None:
        found.spans.append(Span("armed", since, found.duration_s, "armed", "mode"))


def _add_armed_by_motors(found: FlightData) -> None:
    """Arming by a copter's motors, which turn while it is armed; nothing else may say it."""
    motors = outputs_by_function(found) if found.vehicle == COPTER else []
    if motors and not any(span.lane == "armed" for span in found.spans):
        turning = np.max([motor.value for motor in motors], axis=0) > LEAST_SPIN
        words = ["armed" if on else "disarmed" for on in turning.tolist()]
        found.spans.extend(value_spans("armed", motors[0].t_s, words))


def _lasting(lane: str, t_s: Vector, words: list[str], end_s: float) -> list[Span]:
    """Spans of equal words, the last one until the end of the log."""
    return value_spans(lane, np.append(t_s, end_s), [*words, words[-1]]) if words else []


def _add_core(found: FlightData, log: DataflashFile, start_us: int) -> None:
    """Add the estimator core in use, if there is more than one."""
    topic = next((t for k in ESTIMATORS if (t := log.topics.get((k, 0))) and "PI" in t), None)
    # Core 0 throughout is normal and gets no lane.
    if topic is None or not topic["PI"].any():
        return
    names = [f"core {number + 1}" for number in topic["PI"].tolist()]
    spans = value_spans("estimator in use", _seconds(topic, start_us), names)
    found.spans.extend(spans)
    # The first one is the initial state.
    events = (Event(span.start_s, "mode", f"estimator: {span.text}", 4) for span in spans[1:])
    found.events.extend(events)


def _utc0_us(log: DataflashFile, start_us: int) -> int:
    """UTC at `start_us` in us, from GPS week and time of the first fix; 0 if there is none."""
    topic = log.topics.get(("GPS", 0), {})
    if not {"GWk", "GMS"} <= topic.keys() or not topic["GWk"].any():
        return 0
    # Weeks are zero before the first fix.
    first = int(np.flatnonzero(topic["GWk"])[0])
    of_week_us = int(topic["GMS"][first]) * 1000
    gps_us = int(topic["GWk"][first]) * WEEK_US + of_week_us - LEAP_US
    return GPS_EPOCH_US + gps_us - int(topic["TimeUS"][first]) + start_us


def _add_texts(found: FlightData, log: DataflashFile, start_us: int) -> None:
    """Add messages and errors."""
    if (topic := _topic(log, "MSG", texts=("Message",))) is not None:
        for t_s, text in zip(_seconds(topic, start_us).tolist(), topic["Message"], strict=True):
            found.events.append(Event(t_s, "text", _text(text), UNGRADED))
    if (topic := _topic(log, "ERR", numbers=("Subsys", "ECode"))) is not None:
        rows = zip(_seconds(topic, start_us).tolist(), topic["Subsys"], topic["ECode"], strict=True)
        for t_s, subsystem, code in rows:
            name = ERRORS.get(int(subsystem), f"subsystem {subsystem}")
            text = f"{name}: error {code}" if code else f"{name}: resolved"
            # A code of zero means that the error is resolved.
            found.events.append(Event(t_s, "error", text, ERROR_SEVERITY if code else 6))


def _add_parameters(found: FlightData, log: DataflashFile, start_us: int) -> None:
    topic = _topic(log, "PARM", numbers=("Value",), texts=("Name",))
    if topic is None:
        return
    t_s_of = _seconds(topic, start_us).tolist()
    for t_s, name, value in zip(t_s_of, topic["Name"], topic["Value"], strict=True):
        found.add_parameter(_text(name), t_s, float(value))
    if "Default" in topic:
        pairs = zip(topic["Name"], topic["Default"].tolist(), strict=True)
        # NaN means that the firmware has no default.
        found.defaults.update((_text(name), value) for name, value in pairs if np.isfinite(value))
