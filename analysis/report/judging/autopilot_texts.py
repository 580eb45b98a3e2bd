"""Check of the autopilot's messages: alarming ones while armed, merged and ranked by severity.

A message is rated by its severity if the log gives one, else by keywords: a notice warns at most,
information never does. A message such as "GPS glitch cleared" ends the time window that "GPS
glitch" began.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from analysis.report.curves.recording import UNGRADED, Event, FlightData, Windows
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck
from analysis.scoring.vehicle_outcome import HIT_GROUND, is_crash_text, is_within

ALARMING = re.compile(
    r"failsafe|crash|emergency|parachute|terminat|thrust loss|lost position|gps glitch"
    r"|ekf .*(variance|lane switch)|compass.*(variance|inconsistent)|unhealthy|timeout"
    r"|low battery|battery .*(low|critical)|failure|interference|fail(ed)?\b|stale|yaw imbalance",
    re.IGNORECASE,
)
SEVERE = re.compile(
    r"crash|emergency|parachute|terminat|failsafe(?!.*(short|clear))|thrust loss",
    re.IGNORECASE,
)
# What ArduPilot sends as information or a notice, though words of alarm are in it; a dataflash log
# has no severities (send_text in its libraries, vehicles of 4.7).
INFORMATION = re.compile(
    r"^(precland|autotune|net|ppp|smartrtl|tmode|windvane): "
    r"|^(takeoff timeout|vtol pos1|scripting: failed to create|parachute already"
    r"|parachute: landed|opendroneid|format|saved crash_dump|db init|aborting termination"
    r"|unable to terminate|failed( to (pause|resume|find|load))?$|terrain failsafe recovery)"
    r"|transport initialization|because (no samples|of zero flow)",
    re.IGNORECASE,
)
RELEASED = re.compile(r"parachute:? released", re.IGNORECASE)
# A setting or a check that is switched, not a condition.
SETTING = re.compile(r"\b(dis|en)abled\b|\bset to\b|\bnot required\b", re.IGNORECASE)
ENDED = re.compile(
    r"\b(cleared|resolved|recovered|regained|restored|ended|off|ok)\b", re.IGNORECASE
)
# "BARO #0 failed: OFF!" and "compass not ok" do not end a condition.
NOT_ENDED = re.compile(r"\bfail(ed|s|ure)?\b.*\boff\b|\bnot (yet )?\w+", re.IGNORECASE)
PRE_ARM = re.compile(r"pre-?arm|preflight|arming denied|^arm(ing)?:", re.IGNORECASE)
ALERT, ERROR, WARNING, NOTICE = 1, 3, 4, 5  # MAV_SEVERITY
TEXTS_SHOWN = 5  # messages quoted in the evidence
AFTER_DISARM_S = 2.0  # chosen: a crash message may be logged just after the disarming it reports
NAME = "messages of the autopilot"
LIMIT = "warn: an error or alarming message; fail: emergency, alert, crash or failsafe while armed"


@dataclass(slots=True)
class TextFinding:
    """One alarming message: its verdict, highest severity and time windows."""

    text: str
    verdict: str
    severity: int
    windows: list[tuple[float, float]]


def is_alarming(event: Event) -> bool:
    """Whether an event is alarming: by its severity, else by keywords."""
    if event.kind == "error":
        return event.severity <= WARNING
    # Cleared conditions and pre-arm messages are not alarming in flight.
    quiet = (PRE_ARM, SETTING, INFORMATION)
    if is_over(event.text) or any(words.search(event.text) for words in quiet):
        return False
    if is_loss(event.text):
        return True
    if event.severity == UNGRADED:
        return bool(ALARMING.search(event.text))
    # Errors and worse are always alarming; lesser severities only with a keyword.
    if event.severity <= ERROR:
        return True
    word = {WARNING: ALARMING, NOTICE: SEVERE}.get(event.severity)
    return word is not None and bool(word.search(event.text))


def is_loss(text: str) -> bool:
    """Whether a message reports a hard impact or a released parachute, whatever its severity:
    ArduPilot and its simulator send them as information."""
    hit = HIT_GROUND.search(text) is not None and is_crash_text(text)
    return hit or bool(RELEASED.search(text))


def is_over(text: str) -> bool:
    """Whether a message reports the end of a condition."""
    return bool(ENDED.search(text)) and not NOT_ENDED.search(text)


def texts_check(recording: FlightData, armed: Windows | None) -> FlightCheck:
    """Check the messages and errors while armed; `before arming` checks those on the bench."""
    spoken = [event for event in recording.events if event.kind in ("text", "error")]
    if not spoken:
        # A log without messages does not show that the autopilot sent none.
        return FlightCheck(NAME, NONE, "no messages in the log")
    found = find_alarms(spoken, armed)
    if not found:
        return FlightCheck(NAME, PASS, f"{len(spoken)} messages, none alarming")
    shown = ", ".join(_shown(finding) for finding in found[:TEXTS_SHOWN])
    if len(found) > TEXTS_SHOWN:
        shown += f" and {len(found) - TEXTS_SHOWN} less severe"
    worst = FAIL if any(finding.verdict == FAIL for finding in found) else WARN
    windows = tuple(sorted(window for finding in found for window in finding.windows))
    return FlightCheck(NAME, worst, shown, LIMIT, windows)


def find_alarms(spoken: Sequence[Event], armed: Windows | None) -> list[TextFinding]:
    """Alarming messages, equal ones merged, the most severe first; windows end where cleared."""
    found: dict[str, TextFinding] = {}
    for event in spoken:
        subject = _subject(event.text)
        if is_over(event.text) or (event.kind == "error" and not is_alarming(event)):
            _end(found.get(subject), event.t_s)
            continue
        lost = is_loss(event.text)
        grave = (
            event.severity <= ALERT
            or lost
            or (event.severity != NOTICE and bool(SEVERE.search(event.text)))
        )
        crashed = is_crash_text(event.text) or lost
        flown = is_within(event.t_s, armed) or (
            crashed and is_within(event.t_s - AFTER_DISARM_S, armed)
        )
        if is_alarming(event) and flown:
            finding = found.setdefault(subject, TextFinding(event.text, WARN, event.severity, []))
            finding.verdict = FAIL if grave else finding.verdict
            # The highest severity of all messages on this subject.
            finding.severity = min(finding.severity, event.severity)
            # Half a second wide, so that it is visible on the page.
            finding.windows.append((event.t_s, event.t_s + 0.5))
    return sorted(found.values(), key=lambda f: (f.verdict != FAIL, f.severity, f.windows[0]))


def _end(finding: TextFinding | None, t_s: float) -> None:
    """End the last window of a finding."""
    if finding is not None:
        start_s, _ = finding.windows[-1]
        finding.windows[-1] = start_s, t_s


def _subject(text: str) -> str:
    """The message's subject: its text without numbers and without words such as "cleared"."""
    # "GPS glitch" and "GPS glitch cleared" have one subject.
    words = ENDED.sub("", re.sub(r"[-+]?\d+(\.\d+)?|error", "", text)).lower()
    return " ".join(words.replace(":", " ").split())


def _shown(finding: TextFinding) -> str:
    count = len(finding.windows)
    start_s, end_s = finding.windows[0]
    often = f", {count} times" if count > 1 else ""
    # Windows of half a second have no known end.
    until = f" to {end_s:.1f}" if end_s - start_s > 0.6 else ""
    return f"{finding.text!r} at {start_s:.1f}{until} s{often}"
