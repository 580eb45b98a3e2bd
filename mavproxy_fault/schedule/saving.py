"""Writes a running schedule back to YAML."""

from collections.abc import Iterable
from typing import Any

import msgspec

from mavproxy_fault.documents.yaml_document import write_yaml
from mavproxy_fault.schedule.entries import Entry


def write_schedule(seed: int, entries: Iterable[tuple[Entry, float]]) -> str:
    """Format entries for `read_schedule`, each with the offset [s] of its times."""
    written: dict[str, dict[str, Any]] = {}
    for entry, offset_s in entries:
        # The parts of a preset were one item of the file and become one again.
        item = entry.id.rpartition(".")[0] if entry.preset else ""  # a part of several
        data = {"id": item or entry.id, **entry.written}
        # The times of live edits count from the edit and are shifted to the schedule's start,
        # but not those that count from a flight event.
        if offset_s and entry.moment is None:
            data["at_s"] = round(offset_s + entry.at_s, 6)
        written.setdefault(data["id"], data)
    faults = msgspec.to_builtins(list(written.values()))
    return write_yaml({"seed": seed, "faults": faults})
