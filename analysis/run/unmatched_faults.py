"""Report in a summary the scheduled faults that matched no message."""

from collections.abc import Sequence
from typing import Any

from mavproxy_fault.schedule.entries import Schedule, never_acted
from mavproxy_fault.wire.label import Label


def report_unmatched_faults(
    summary: dict[str, Any], schedule: Schedule, labels: Sequence[Label]
) -> None:
    """Add faults that never acted to a summary; if no fault acted, PASS becomes NO VERDICT."""
    summary["never_acted"] = never_acted(schedule, {label.id for label in labels})
    if schedule.faults and not labels and summary["verdict"] == "PASS":
        summary["verdict"] = "NO VERDICT"
