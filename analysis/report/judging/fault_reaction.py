"""What a log without results of the monitor tells of a fault: the autopilot's reaction, our checks.

The autopilot speaks by its flags, its messages and the steps of its position; the checks by their
windows. What names a sensor blames it. The outcome follows from the same rules as a run's. In a
recording that was edited afterwards the autopilot could not react: there only checks count.
"""

import re
from collections.abc import Sequence
from typing import Any

import msgspec

from analysis.report.judging.autopilot_texts import is_alarming
from analysis.report.judging.checks import FlightCheck
from analysis.report.recordings.recording import Event, FlightData
from analysis.scoring.alarm_windows import AlarmWindow
from analysis.scoring.fault_channels import fault_visibility
from analysis.scoring.outcome import MISSED, NEVER_US, NOT_JUDGED, FaultOutcome, fault_outcomes
from mavproxy_fault.wire.label import Label

AFTER_FAULT_S = 15.0  # what follows a fault's end so soon is its echo
SAMPLE_US = 1_000_000  # a check's window may begin with the sample before a fault
REACTION_US = 10_000_000  # how long an estimator may hold out against its sensors
AUTOPILOT = "autopilot"  # the channel of what names no sensor
SENSOR_PATTERNS = (
    ("gps-position", re.compile(r"gps|gnss", re.IGNORECASE)),
    ("mag", re.compile(r"compass|\bmag\b|magnet", re.IGNORECASE)),
    ("baro", re.compile(r"\bbaro", re.IGNORECASE)),
    ("airspeed", re.compile(r"airspeed|\btas\b", re.IGNORECASE)),
    ("imu", re.compile(r"gyro|accel|\bacc\b|\bimu\b|\bins\b", re.IGNORECASE)),
    ("range", re.compile(r"range ?finder|distance sensor", re.IGNORECASE)),
    ("vision", re.compile(r"vision|visual|odometry|flow", re.IGNORECASE)),
)
CHECK_CHANNELS = {
    **dict.fromkeys(("GPS fix", "GPS satellites", "GPS dilution of precision"), "gps-position"),
    **dict.fromkeys(("GPS jumps", "GPS jamming indicator"), "gps-position"),
    "compass field strength": "mag",
    "vibration": "imu",
    "accelerometer clipping": "imu",
    "gyroscopes agree": "imu",
    "accelerometers agree": "imu",
}


def fault_reactions(
    labels: Sequence[Label], recording: FlightData, checks: Sequence[FlightCheck]
) -> list[dict[str, Any]]:
    """One row per label, in the form of `summary.json`'s `faults`, with what was said and when."""
    edited = [label for label in labels if label.recorded]
    spoken = [event for event in recording.events if _is_reaction(event)]
    # The end of a trouble blames nobody.
    raised = [e for e in spoken if not (e.kind == "flag" and e.text.endswith("cleared"))]
    heard = [_of_event(e, recording) for e in raised]
    # The log was changed after the flight: the autopilot never saw the fault.
    if edited:
        heard = _of_checks(checks, recording, labels)
    heard.sort(key=lambda window: window.start_us)
    # Which sensors anybody watched: an unwatched one cannot have been missed.
    watched = (
        {CHECK_CHANNELS[check.name] for check in checks if _was_judged(check)} if edited else set()
    )
    if edited or recording.autopilot:
        watched |= {AUTOPILOT, *(name for name, _ in SENSOR_PATTERNS)}
    # Estimators hold out against their sensors for seconds before they give in.
    rows = fault_outcomes(labels, heard, watched, REACTION_US, witnesses=frozenset({AUTOPILOT}))
    return [
        _row(row, label, labels, [] if label.recorded else spoken, recording)
        for row, label in zip(rows, labels, strict=True)
    ]


def _was_judged(check: FlightCheck) -> bool:
    return check.name in CHECK_CHANNELS and check.verdict != "not judged"


def _of_checks(
    checks: Sequence[FlightCheck], recording: FlightData, labels: Sequence[Label]
) -> list[AlarmWindow]:
    """What the checks hold against sensors. One that speaks where nothing was edited tells of the
    flight as it was: for an edit of its own sensor it counts, against others it proves nothing."""
    found = []
    for check in filter(_was_judged, checks):
        name = CHECK_CHANNELS[check.name]
        spans = [(_stamp(b, recording), _stamp(e, recording)) for b, e in check.windows]
        troubled = any(not any(_within(span, label) for label in labels) for span in spans)
        for begin_us, end_us in spans:
            own = [one for one in labels if _within((begin_us, end_us), one)]
            own = [one for one in own if fault_visibility(one).allows(name)]
            # A window may begin with the sample before the fault.
            begin_us = min((max(begin_us, one.start_us) for one in own), default=begin_us)
            if own or not troubled:
                found.append(AlarmWindow(name, name, begin_us, max(begin_us, end_us), 1, True))
    return found


def _within(span: tuple[int, int], label: Label) -> bool:
    """Whether a stretch of time may be the doing of a fault."""
    end_us = NEVER_US if label.end_us is None else label.end_us
    return label.start_us - SAMPLE_US <= span[0] and span[1] <= end_us + round(AFTER_FAULT_S * 1e6)


def _stamp(t_s: float, recording: FlightData) -> int:
    return recording.t0_us + round(t_s * 1e6)


def _of_event(event: Event, recording: FlightData) -> AlarmWindow:
    t_us = _stamp(event.t_s, recording)
    # The first word that names a sensor.
    name = next((sensor for sensor, words in SENSOR_PATTERNS if words.search(event.text)), "")
    return AlarmWindow(name or AUTOPILOT, name, t_us, t_us, 1, bool(name))


def _row(
    row: FaultOutcome,
    label: Label,
    labels: Sequence[Label],
    spoken: Sequence[Event],
    recording: FlightData,
) -> dict[str, Any]:
    found: dict[str, Any] = msgspec.to_builtins(row)
    # The log was changed afterwards: silence of the autopilot is no miss.
    if label.recorded and row.verdict == MISSED:
        found |= {"verdict": NOT_JUDGED, "reason": "the autopilot could not react (recorded)"}
    start_s = (label.start_us - recording.t0_us) * 1e-6
    end_us = label.end_us
    end_s = recording.duration_s if end_us is None else (end_us - recording.t0_us) * 1e-6
    # What is said after the next fault began may be its doing.
    later = [(one.start_us - recording.t0_us) * 1e-6 for one in labels]
    until = min([end_s + AFTER_FAULT_S, *(t_s for t_s in later if t_s > start_s)])
    found["reaction"] = [
        {"t_s": round(e.t_s, 3), "after_s": round(e.t_s - start_s, 3), "text": e.text}
        for e in spoken
        if start_s <= e.t_s <= until
    ]
    return found


def _is_reaction(event: Event) -> bool:
    if event.kind in ("text", "error"):
        return is_alarming(event)
    return event.kind in ("flag", "reset")
