"""Outcome of each fault in a log without monitor results, from the autopilot's reactions.

Reactions are flags, messages and position resets; one that names a sensor counts as isolating it.
The outcome follows from the same rules as in a run. If faults were injected into a recorded log,
the autopilot could not react, and failed checks take the place of its reactions.
"""

import re
from collections.abc import Sequence
from typing import Any

import msgspec

from analysis.report.curves.recording import Event, FlightData
from analysis.report.judging.autopilot_texts import is_alarming
from analysis.report.judging.checks import FlightCheck
from analysis.results import FOREVER_US
from analysis.scoring.alarm_windows import AlarmWindow
from analysis.scoring.fault_channels import fault_visibility
from analysis.scoring.outcome import MISSED, NOT_JUDGED, FaultOutcome, fault_outcomes
from mavproxy_fault.wire.label import Label

AFTER_FAULT_S = 15.0  # chosen: alarms this soon after a fault's end are attributed to it
SAMPLE_US = 1_000_000  # a check's window may begin one sample before the fault
REACTION_US = 10_000_000  # chosen: estimators reject a faulty sensor this long before they reset
AUTOPILOT = "autopilot"  # channel of reactions that name no sensor
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
    """One row per label, like `faults` in `summary.json`, with the autopilot's reactions."""
    edited = [label for label in labels if label.recorded]
    spoken = [event for event in recording.events if _is_reaction(event)]
    # A cleared flag isolates no sensor.
    raised = [e for e in spoken if not (e.kind == "flag" and e.text.endswith("cleared"))]
    heard = [_of_event(e, recording) for e in raised]
    # Faults injected after the flight: the autopilot could not react.
    if edited:
        heard = _of_checks(checks, recording, labels)
    heard.sort(key=lambda window: window.start_us)
    # Sensors that are monitored: a fault of any other one cannot be missed.
    watched = (
        {CHECK_CHANNELS[check.name] for check in checks if _was_judged(check)} if edited else set()
    )
    if edited or recording.autopilot:
        watched |= {AUTOPILOT, *(name for name, _ in SENSOR_PATTERNS)}
    # Estimators reject a faulty sensor for seconds before they reset.
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
    """Alarms from failed checks. A check that fails outside the injected faults shows a problem of
    the original flight; its windows then count only for faults of its own sensor."""
    found = []
    for check in filter(_was_judged, checks):
        name = CHECK_CHANNELS[check.name]
        spans = [(_stamp(b, recording), _stamp(e, recording)) for b, e in check.windows]
        troubled = any(not any(_within(span, label) for label in labels) for span in spans)
        for begin_us, end_us in spans:
            own = [one for one in labels if _within((begin_us, end_us), one)]
            own = [one for one in own if fault_visibility(one).allows(name)]
            # A window may begin one sample before the fault.
            begin_us = min((max(begin_us, one.start_us) for one in own), default=begin_us)
            if own or not troubled:
                found.append(AlarmWindow(name, name, begin_us, max(begin_us, end_us), 1, True))
    return found


def _within(span: tuple[int, int], label: Label) -> bool:
    """Whether a time span can be caused by a fault."""
    end_us = FOREVER_US if label.end_us is None else label.end_us
    return label.start_us - SAMPLE_US <= span[0] and span[1] <= end_us + round(AFTER_FAULT_S * 1e6)


def _stamp(t_s: float, recording: FlightData) -> int:
    return recording.t0_us + round(t_s * 1e6)


def _of_event(event: Event, recording: FlightData) -> AlarmWindow:
    t_us = _stamp(event.t_s, recording)
    # The first sensor named in the text.
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
    # Faults injected after the flight cannot be missed by the autopilot.
    if label.recorded and row.verdict == MISSED:
        found |= {
            "verdict": NOT_JUDGED,
            "reason": "injected into a recording: the autopilot could not react",
        }
    start_s = (label.start_us - recording.t0_us) * 1e-6
    end_us = label.end_us
    end_s = recording.duration_s if end_us is None else (end_us - recording.t0_us) * 1e-6
    # A reaction after the next fault began may be caused by that one.
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
