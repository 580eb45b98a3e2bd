"""What an autopilot said, merged and ranked: how grave, how often, while armed or not.

A text counts by its severity where the log gives one, by its words where it does not. One that
says that something is over ends the window that the text before it began.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck, Windows, is_within
from analysis.report.recordings.recording import UNGRADED, Event, FlightData

ALARMING = re.compile(
    r"failsafe|crash|emergency|parachute|terminat|thrust loss|lost position|gps glitch"
    r"|ekf .*(variance|lane switch)|compass.*(variance|inconsistent)|unhealthy|timeout"
    r"|low battery|battery .*(low|critical)|failure|interference|fail(ed)?\b|stale|yaw imbalance",
    re.IGNORECASE,
)
SEVERE = re.compile(
    r"crash|emergency|parachute|terminat|failsafe(?!.*(short|clear))|thrust loss|hit ground",
    re.IGNORECASE,
)
ENDED = re.compile(
    r"\b(cleared|resolved|recovered|regained|restored|ended|off|ok)\b", re.IGNORECASE
)
# "BARO #0 failed: OFF!" is no end, nor is "compass not ok".
NOT_ENDED = re.compile(r"\bfail(ed|s|ure)?\b.*\boff\b|\bnot (yet )?\w+", re.IGNORECASE)
PRE_ARM = re.compile(r"pre-?arm|preflight|arming denied|^arm(ing)?:", re.IGNORECASE)
ALERT, ERROR, WARNING = 1, 3, 4  # MAV_SEVERITY
TEXTS_SHOWN = 5  # texts of the evidence
AFTER_DISARM_S = (
    2.0  # who disarms for a crash says so, which may be written down after the disarming
)
NAME = "messages of the autopilot"
LIMIT = "warn: an error or an alarming text; fail: emergency, alert, crash or failsafe while armed"


@dataclass(slots=True)
class TextFinding:
    """One text that raises a question: how often, from when to when, how grave."""

    text: str
    verdict: str
    severity: int
    windows: list[tuple[float, float]]


def is_alarming(event: Event) -> bool:
    """Whether something said asks for attention: by its severity, else by its words."""
    if event.kind == "error":
        return event.severity <= WARNING
    # What is over, and what was refused on the bench, alarms nobody in flight.
    if is_over(event.text) or PRE_ARM.search(event.text):
        return False
    if event.severity == UNGRADED:
        return bool(ALARMING.search(event.text))
    # Errors and worse alarm by themselves; a warning must do so by its words too.
    if event.severity <= ERROR:
        return True
    return bool((ALARMING if event.severity == WARNING else SEVERE).search(event.text))


def is_over(text: str) -> bool:
    """Whether a text says that something has ended."""
    return bool(ENDED.search(text)) and not NOT_ENDED.search(text)


def texts_check(recording: FlightData, armed: Windows | None) -> FlightCheck:
    """The texts and errors of a flight; those of the bench are left to `before arming`."""
    spoken = [event for event in recording.events if event.kind in ("text", "error")]
    if not spoken:
        # Silence of a log without messages is not silence of the autopilot.
        return FlightCheck(name=NAME, verdict=NONE, evidence="no messages in the log")
    found = find_alarms(spoken, armed)
    if not found:
        return FlightCheck(
            name=NAME, verdict=PASS, evidence=f"{len(spoken)} messages, none alarming"
        )
    shown = ", ".join(_shown(finding) for finding in found[:TEXTS_SHOWN])
    if len(found) > TEXTS_SHOWN:
        shown += f" and {len(found) - TEXTS_SHOWN} less grave"
    worst = FAIL if any(finding.verdict == FAIL for finding in found) else WARN
    windows = tuple(sorted(window for finding in found for window in finding.windows))
    return FlightCheck(name=NAME, verdict=worst, evidence=shown, limit=LIMIT, windows=windows)


def find_alarms(spoken: Sequence[Event], armed: Windows | None) -> list[TextFinding]:
    """Alarming texts, equal ones as one, the gravest first; what ended has a window to its end."""
    found: dict[str, TextFinding] = {}
    for event in spoken:
        subject = _subject(event.text)
        if is_over(event.text) or (event.kind == "error" and not is_alarming(event)):
            _end(found.get(subject), event.t_s)
            continue
        grave = event.severity <= ALERT or bool(SEVERE.search(event.text))
        flown = is_within(event.t_s, armed) or (
            grave and is_within(event.t_s - AFTER_DISARM_S, armed)
        )
        if is_alarming(event) and flown:
            finding = found.setdefault(subject, TextFinding(event.text, WARN, event.severity, []))
            finding.verdict = FAIL if grave else finding.verdict
            # The gravest of all that were said of the subject.
            finding.severity = min(finding.severity, event.severity)
            # Half a second wide, so that it can be seen on the page.
            finding.windows.append((event.t_s, event.t_s + 0.5))
    return sorted(found.values(), key=lambda f: (f.verdict != FAIL, f.severity, f.windows[0]))


def _end(finding: TextFinding | None, t_s: float) -> None:
    """What began last is over now."""
    if finding is not None:
        start_s, _ = finding.windows[-1]
        finding.windows[-1] = start_s, t_s


def _subject(text: str) -> str:
    """A text without numbers and without saying whether it begins or ends."""
    # So that "GPS glitch" and "GPS glitch cleared" are one subject.
    words = ENDED.sub("", re.sub(r"[-+]?\d+(\.\d+)?|error", "", text)).lower()
    return " ".join(words.replace(":", " ").split())


def _shown(finding: TextFinding) -> str:
    count = len(finding.windows)
    start_s, end_s = finding.windows[0]
    often = f", {count} times" if count > 1 else ""
    # Half a second is the width that was made up for the page.
    until = f" to {end_s:.1f}" if end_s - start_s > 0.6 else ""
    return f"{finding.text!r} at {start_s:.1f}{until} s{often}"
