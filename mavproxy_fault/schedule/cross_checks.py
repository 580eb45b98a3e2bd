"""Checks across the entries of a schedule: unique ids and valid `after` references.

They use the data as written, so that an invalid entry still counts as existing.
"""

import re
from typing import Any

from mavproxy_fault.documents.document_check import DocumentCheck
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.schedule.presets import preset_names, preset_parts

# Ids are parts of Zenoh keys, where these characters and a leading `@` are special, surrogates
# cannot be encoded and the length is limited. `all` means all faults.
ID = re.compile(r"(?!@|all\Z)[^/*$?#\ud800-\udfff]{1,200}")
WRONG_ID = "is not valid; give up to 200 characters without / * $ ? # or a leading @, and not `all`"


def default_id(name: str, number: int) -> str:
    """Return the default id of the fault at position `number` (from 0) of the list."""
    return f"{name}-{number + 1}"


def entry_ids(data: dict[str, Any], number: int) -> list[str]:
    """Return the ids of the entries of one list item: several for some presets."""
    preset = data.get("preset")
    if preset not in preset_names():
        return [str(data.get("id") or default_id(str(data.get("fault")), number))]
    prefix, parts = data.get("id", preset), len(preset_parts(str(preset)))
    return [f"{prefix}.{i + 1}" for i in range(parts)] if parts > 1 else [str(prefix)]


def check_id(id: str, where: str) -> None:
    """Refuse an id that cannot be part of a Zenoh key.

    Raises
    ------
    ConfigError
        If the id is not valid.
    """
    if not ID.fullmatch(id):
        raise ConfigError(f"{where}: id = {id[:200]!r} {WRONG_ID}")


def check_together(listed: list[Any], check: DocumentCheck) -> None:
    """Add errors for duplicate ids, and for `after` with an unknown fault or a cycle."""
    places: dict[str, int] = {}
    for i, item in enumerate(listed):
        for id in entry_ids(item, i) if isinstance(item, dict) else ():
            if id in places:
                check.wrong(("faults", i, "id"), f"= {id} is given twice; ids must differ")
            places.setdefault(id, i)
            if not ID.fullmatch(id):  # not a Zenoh key
                check.wrong(("faults", i, "id"), f"= {id[:200]!r} {WRONG_ID}")
    waits: dict[str, str] = {}
    for i, item in enumerate(listed):
        awaited = _awaited(item.get("after")) if isinstance(item, dict) else None
        if awaited is None:
            continue
        # Waiting for another part of the same item counts as waiting for itself.
        if awaited not in places or places[awaited] == i:
            others = [name for name, place in places.items() if place != i]
            text = f"= {awaited} is not another fault; {suggest_known(awaited, others)}"
            check.wrong(("faults", i, "after"), text)
        else:
            waits.update((id, awaited) for id in entry_ids(item, i) if places[id] == i)
    _check_cycles(waits, places, check)


def _awaited(after: Any) -> str | None:
    """Return the id that an `after` names; None if it has none."""
    name = after.get("id") if isinstance(after, dict) else after
    return name if isinstance(name, str) else None


def _check_cycles(waits: dict[str, str], places: dict[str, int], check: DocumentCheck) -> None:
    # Each id is visited once, even if several chains lead to it.
    done: set[str] = set()
    for first in waits:
        chain: list[str] = []
        id = first
        while id in waits and id not in done:
            done.add(id)
            chain.append(id)
            id = waits[id]
        if id in chain:
            cycle = " after ".join([*chain[chain.index(id) :], id])
            text = f"is a cycle ({cycle}); remove one of them"
            check.wrong(("faults", places[id], "after"), text)
