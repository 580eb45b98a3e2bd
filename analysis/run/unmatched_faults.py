"""What of a schedule met nothing, told in a summary."""

from collections.abc import Sequence
from typing import Any

from mavproxy_fault.schedule.entries import Schedule, never_acted
from mavproxy_fault.wire.label import Label


def report_unmatched_faults(
    summary: dict[str, Any], schedule: Schedule, labels: Sequence[Label]
) -> None:
    """Put into a summary what of a schedule met nothing; where all of it did nothing was tested."""
    summary["never_acted"] = never_acted(schedule, {label.id for label in labels})
    if schedule.faults and not labels and summary["verdict"] == "PASS":
        summary["verdict"] = "NO VERDICT"
