"""What an autopilot said, merged and ranked: how grave, how often, while armed or not.

A text counts by its severity where the log gives one, by its words where it does not. One that
says that something is over ends the window that the text before it began.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, Check, Windows, within
from analysis.report.recordings.recording import UNGRADED, Event, Recording

ALARMING = re.compile(
    r"failsafe|crash|emergency|parachute|terminat|thrust loss|lost position|gps glitch"
    r"|ekf .*(variance|lane switch)|compass.*(variance|inconsistent)|unhealthy|timeout"
    r"|low battery|battery .*(low|critical)|failure|interference|fail(ed)?\b|stale|yaw imbalance",
    re.IGNORECASE,
)
GRAVE = re.compile(
    r"crash|emergency|parachute|terminat|failsafe(?!.*(short|clear))|thrust loss|hit ground",
    re.IGNORECASE,
)
OVER = re.compile(r"\b(cleared|resolved|recovered|regained|restored|ended|off|ok)\b", re.IGNORECASE)
# "BARO #0 failed: OFF!" is no end, nor is "compass not ok".
NOT_OVER = re.compile(r"\bfail(ed|s|ure)?\b.*\boff\b|\bnot (yet )?\w+", re.IGNORECASE)
BENCH = re.compile(r"pre-?arm|preflight|arming denied|^arm(ing)?:", re.IGNORECASE)
ALERT, ERROR, WARNING = 1, 3, 4  # MAV_SEVERITY
SHOWN = 5  # texts of the evidence
AFTER_S = 2.0  # who disarms for a crash says so, which may be written down after the disarming
NAME = "messages of the autopilot"
LIMIT = "warn: an error or an alarming text; fail: emergency, alert, crash or failsafe while armed"


@dataclass(slots=True)
class Finding:
    """One text that raises a question: how often, from when to when, how grave."""

    text: str
    verdict: str
    severity: int
    windows: list[tuple[float, float]]


def alarming(event: Event) -> bool:
    """Whether something said asks for attention: by its severity, else by its words."""
    if event.kind == "error":
        return event.severity <= WARNING
    # What is over, and what was refused on the bench, alarms nobody in flight.
    if over(event.text) or BENCH.search(event.text):
        return False
    if event.severity == UNGRADED:
        return bool(ALARMING.search(event.text))
    # Errors and worse alarm by themselves; a warning must do so by its words too.
    if event.severity <= ERROR:
        return True
    return bool((ALARMING if event.severity == WARNING else GRAVE).search(event.text))


def over(text: str) -> bool:
    """Whether a text says that something has ended."""
    return bool(OVER.search(text)) and not NOT_OVER.search(text)


def texts_check(recording: Recording, armed: Windows | None) -> Check:
    """The texts and errors of a flight; those of the bench are left to `before arming`."""
    spoken = [event for event in recording.events if event.kind in ("text", "error")]
    if not spoken:
        # Silence of a log without messages is not silence of the autopilot.
        return Check(name=NAME, verdict=NONE, evidence="no messages in the log")
    found = findings(spoken, armed)
    if not found:
        return Check(name=NAME, verdict=PASS, evidence=f"{len(spoken)} messages, none alarming")
    shown = ", ".join(_shown(finding) for finding in found[:SHOWN])
    if len(found) > SHOWN:
        shown += f" and {len(found) - SHOWN} less grave"
    worst = FAIL if any(finding.verdict == FAIL for finding in found) else WARN
    windows = tuple(sorted(window for finding in found for window in finding.windows))
    return Check(name=NAME, verdict=worst, evidence=shown, limit=LIMIT, windows=windows)


def findings(spoken: Sequence[Event], armed: Windows | None) -> list[Finding]:
    """Alarming texts, equal ones as one, the gravest first; what ended has a window to its end."""
    found: dict[str, Finding] = {}
    for event in spoken:
        subject = _subject(event.text)
        if over(event.text) or (event.kind == "error" and not alarming(event)):
            _end(found.get(subject), event.t_s)
            continue
        grave = event.severity <= ALERT or bool(GRAVE.search(event.text))
        flown = within(event.t_s, armed) or (grave and within(event.t_s - AFTER_S, armed))
        if alarming(event) and flown:
            finding = found.setdefault(subject, Finding(event.text, WARN, event.severity, []))
            finding.verdict = FAIL if grave else finding.verdict
            # The gravest of all that were said of the subject.
            finding.severity = min(finding.severity, event.severity)
            # Half a second wide, so that it can be seen on the page.
            finding.windows.append((event.t_s, event.t_s + 0.5))
    return sorted(found.values(), key=lambda f: (f.verdict != FAIL, f.severity, f.windows[0]))


def _end(finding: Finding | None, t_s: float) -> None:
    """What began last is over now."""
    if finding is not None:
        start_s, _ = finding.windows[-1]
        finding.windows[-1] = start_s, t_s


def _subject(text: str) -> str:
    """A text without numbers and without saying whether it begins or ends."""
    # So that "GPS glitch" and "GPS glitch cleared" are one subject.
    words = OVER.sub("", re.sub(r"[-+]?\d+(\.\d+)?|error", "", text)).lower()
    return " ".join(words.replace(":", " ").split())


def _shown(finding: Finding) -> str:
    count = len(finding.windows)
    start_s, end_s = finding.windows[0]
    often = f", {count} times" if count > 1 else ""
    # Half a second is the width that was made up for the page.
    until = f" to {end_s:.1f}" if end_s - start_s > 0.6 else ""
    return f"{finding.text!r} at {start_s:.1f}{until} s{often}"
