"""Schedules written back to YAML, as they stand while they run."""

from collections.abc import Iterable
from typing import Any

import msgspec

from mavproxy_fault.documents.yaml_document import write_yaml
from mavproxy_fault.schedule.entries import Entry


def write_schedule(seed: int, entries: Iterable[tuple[Entry, float]]) -> str:
    """What `read_schedule` takes: entries, each with the seconds after which its times count."""
    written: dict[str, dict[str, Any]] = {}
    for entry, late_s in entries:
        # The parts of a preset were one item of the file, and become one again.
        whole = entry.id.rpartition(".")[0] if entry.preset else ""  # one part of several
        data = {"id": whole or entry.id, **entry.written}
        # Live edits may begin long after the file's own times: they are moved by that much.
        # A moment of the flight is the same whenever they were made.
        if late_s and entry.moment is None:
            data["at_s"] = round(late_s + entry.at_s, 6)
        # Once for all parts.
        written.setdefault(data["id"], data)
    faults = msgspec.to_builtins(list(written.values()))
    return write_yaml({"seed": seed, "faults": faults})
