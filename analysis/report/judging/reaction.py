"""How the autopilot reacted to what was injected, where nobody else judged it.

Its flags, its messages and its steps of position are taken as its voice. What it says while a fault
acts, and shortly after, is put down to that fault: a log alone cannot tell more.
"""

from collections.abc import Sequence
from typing import Any

from analysis.report.judging.flight_checks import ALARMING
from analysis.report.recordings.recording import Event, Recording
from mavproxy_fault.wire.label import Label

ECHO_S = 15.0  # what follows a fault's end so soon is its echo


def reactions(labels: Sequence[Label], recording: Recording) -> list[dict[str, Any]]:
    """One row per label, in the form of `summary.json`'s `faults`, with what was said and when."""
    return [_row(label, labels, recording) for label in labels]


def _row(label: Label, labels: Sequence[Label], recording: Recording) -> dict[str, Any]:
    start_s = (label.start_us - recording.t0_us) * 1e-6
    end_s = None if label.end_us is None else (label.end_us - recording.t0_us) * 1e-6
    later = [(other.start_us - recording.t0_us) * 1e-6 for other in labels]
    until = (end_s if end_s is not None else recording.duration_s) + ECHO_S
    until = min([until, *(t_s for t_s in later if t_s > start_s)])
    said = [e for e in recording.events if start_s <= e.t_s <= until and _speaks(e)]
    return {
        "id": label.id,
        "preset": label.preset,
        "target": ", ".join(label.targets),
        "start_s": round(start_s, 3),
        "end_s": None if end_s is None else round(end_s, 3),
        "frames": label.frames,
        "detected": bool(said),
        "delay_s": round(said[0].t_s - start_s, 3) if said else None,
        "isolated": [],
        "verdict": "detected" if said else "missed",
        "reaction": [
            {"t_s": round(e.t_s, 3), "after_s": round(e.t_s - start_s, 3), "text": e.text}
            for e in said
        ],
    }


def _speaks(event: Event) -> bool:
    if event.kind in ("flag", "reset", "error"):
        return True
    return event.kind == "text" and bool(ALARMING.search(event.text))
