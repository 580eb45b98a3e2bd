"""What a report takes of a dataflash log besides the field map: arming, texts, parameters."""

import re
from collections.abc import Collection

import numpy as np

from analysis.field_maps.autopilot_names import NAMES
from analysis.recordings.flight_logs.autopilot_log import AutopilotLog
from analysis.report.curves.motor_outputs import outputs_by_function
from analysis.report.curves.recording import (
    UNGRADED,
    Event,
    FlightData,
    Message,
    Span,
    value_spans,
)
from analysis.report.curves.vehicle_phase import BUILDS, COPTER, class_by_texts

ERRORS, EVENTS = NAMES["ArduPilot error"], NAMES["ArduPilot event"]
ARMED, DISARMED = 10, 11  # EV.Id
# EV.Id of events that occur once per flight and only while armed.
AUTO_ARMED, NOT_LANDED, MOTORS_ALLOWED = 15, 28, 57
LANDED = 18
ONCE = (AUTO_ARMED, NOT_LANDED, MOTORS_ALLOWED)
PRE_ARM = re.compile(r"^Pre-?Arm:", re.IGNORECASE)  # sent while disarmed
FIRST_TEXTS = 40  # chosen: the firmware names itself among the first texts of a log
ERROR_SEVERITY = 3  # severity of an error
GPS_EPOCH_US = 315_964_800_000_000  # 6 January 1980 in Unix time
WEEK_US = 604_800_000_000
LEAP_US = 18_000_000  # GPS is ahead of UTC since 2017
LEAST_SPIN = 0.02  # chosen: MOT_SPIN_ARM is 0.1, a disarmed motor has no output
NOTHING = Message(np.empty(0), {})


def ardupilot_class(log: AutopilotLog) -> str:
    """Class by the name of the firmware, which is among the first texts, or by the build (VER)."""
    messages = {name: Message(np.empty(0), topic) for (name, _), topic in log.topics.items()}
    parameters = _message(messages, "PARM", numbers=("Value",), texts=("Name",)).columns
    known = dict(zip(map(_text, parameters.get("Name", ())), parameters.get("Value", ()),
                     strict=False))  # fmt: skip
    said = _message(messages, "MSG", texts=("Message",)).columns.get("Message", ())
    build = _message(messages, "VER", numbers=("BU",)).columns.get("BU", [0])[0]
    texts = [_text(text) for text in said[:FIRST_TEXTS]]
    return class_by_texts(texts, known) or BUILDS.get(int(build), "")


def add_ardupilot_parts(found: FlightData) -> int:
    """Add them; returns UTC at zero on the axis in us, 0 if unknown."""
    _add_texts(found)
    _add_reasons(found)
    _add_armed(found)
    refused = any(PRE_ARM.search(event.text) for event in found.events if event.kind == "text")
    if refused and not any(span.lane == "armed" for span in found.spans):
        found.spans.append(Span("armed", 0.0, found.duration_s, "disarmed", "mode"))
    _add_parameters(found)
    _add_armed_by_motors(found)
    return _utc0_us(found)


def _message(
    messages: dict[str, Message],
    name: str,
    numbers: Collection[str] = (),
    texts: Collection[str] = (),
) -> Message:
    """A message with these fields; an empty one without them, as where a format is damaged."""
    message = messages.get(name, NOTHING)
    kinds = {key: column.dtype.kind for key, column in message.columns.items()}
    right = all(kinds.get(key, "") in ("i", "u", "f") for key in numbers)
    return message if right and all(kinds.get(key) == "S" for key in texts) else NOTHING


def _text(value: object) -> str:
    return value.decode("utf-8", "replace").strip() if isinstance(value, bytes) else str(value)


def _add_reasons(found: FlightData) -> None:
    """Add why ArduPilot changed its mode: by a failsafe, or by a command."""
    modes = _message(found.messages, "MODE", numbers=("Rsn",))
    spans = [span for span in found.spans if span.lane == "mode"]
    for t_s, reason in zip(modes.t_s.tolist(), modes.columns.get("Rsn", ()), strict=True):
        text = next((span.text for span in reversed(spans) if span.start_s <= t_s), "")
        if why := NAMES["ArduPilot failsafe"].get(int(reason)):
            found.events.append(Event(t_s, "failsafe", why, 4))
        elif reason:
            found.events.append(Event(t_s, "command", text))


def _add_armed(found: FlightData) -> None:
    """Arming and flight by events, where there are any; a log may begin or end in flight."""
    events = _message(found.messages, "EV", numbers=("Id",))
    rows = list(zip(events.t_s.tolist(), map(int, events.columns.get("Id", ())), strict=True))
    found.events.extend(Event(t_s, "mode", EVENTS[n]) for t_s, n in rows if n in EVENTS)
    armed = [(t_s, "armed" if n == ARMED else "disarmed") for t_s, n in rows
             if n in (ARMED, DISARMED)]  # fmt: skip
    once = [t_s for t_s, number in rows if number in ONCE]
    if not armed or armed[0][1] == "disarmed":
        # The log begins in flight, or the arming event is lost; then an event that occurs once per
        # flight gives the start.
        once = [t_s for t_s in once if not armed or t_s < armed[0][0]]
        armed = [(t_s, "armed") for t_s in (once or [0.0] * len(armed))[:1]] + armed
    if armed and armed[0][0] > 0.0:
        armed.insert(0, (0.0, "disarmed"))
    air = [(t_s, "flying" if n == NOT_LANDED else "landed") for t_s, n in rows
           if n in (NOT_LANDED, LANDED, DISARMED)]  # fmt: skip
    for lane, states in (("armed", armed), ("flying", air)):
        if any(word == lane for _, word in states):
            times, words = zip(*states, strict=True)
            found.spans[:] = [span for span in found.spans if span.lane != lane]
            found.spans.extend(
                value_spans(lane, np.append(times, found.duration_s), [*words, words[-1]])
            )


def _add_armed_by_motors(found: FlightData) -> None:
    """Arming by a copter's motors, which turn while it is armed; nothing else may say it."""
    motors = outputs_by_function(found) if found.vehicle == COPTER else []
    if motors and not any(span.lane == "armed" for span in found.spans):
        turning = np.max([motor.value for motor in motors], axis=0) > LEAST_SPIN
        words = np.where(turning, "armed", "disarmed")
        found.spans.extend(value_spans("armed", motors[0].t_s, words))


def _utc0_us(found: FlightData) -> int:
    """By GPS week and time of the first fix; the week is zero before it."""
    fixes = _message(found.messages, "GPS", numbers=("GWk", "GMS", "TimeUS")).columns
    if not fixes or not fixes["GWk"].any():
        return 0
    first = int(np.flatnonzero(fixes["GWk"])[0])
    of_week_us = int(fixes["GMS"][first]) * 1000
    gps_us = int(fixes["GWk"][first]) * WEEK_US + of_week_us - LEAP_US
    return GPS_EPOCH_US + gps_us - int(fixes["TimeUS"][first]) + found.t0_us


def _add_texts(found: FlightData) -> None:
    """Add messages and errors."""
    said = _message(found.messages, "MSG", texts=("Message",))
    for t_s, text in zip(said.t_s.tolist(), said.columns.get("Message", ()), strict=True):
        found.events.append(Event(t_s, "text", _text(text), UNGRADED))
    errors = _message(found.messages, "ERR", numbers=("Subsys", "ECode"))
    columns = (errors.columns.get(name, ()) for name in ("Subsys", "ECode"))
    for t_s, subsystem, code in zip(errors.t_s.tolist(), *columns, strict=True):
        name = ERRORS.get(int(subsystem), f"subsystem {subsystem}")
        text = f"{name}: error {code}" if code else f"{name}: resolved"
        # A code of zero means that the error is resolved.
        found.events.append(Event(t_s, "error", text, ERROR_SEVERITY if code else 6))


def _add_parameters(found: FlightData) -> None:
    message = _message(found.messages, "PARM", numbers=("Value",), texts=("Name",))
    names = [_text(name) for name in message.columns.get("Name", ())]
    values = message.columns.get("Value", np.empty(0)).tolist()
    for t_s, name, value in zip(message.t_s.tolist(), names, values, strict=True):
        found.add_parameter(name, t_s, float(value))
    if "Default" in message.columns:
        pairs = zip(names, message.columns["Default"].tolist(), strict=True)
        # NaN means that the firmware has no default.
        found.defaults.update((name, value) for name, value in pairs if np.isfinite(value))
