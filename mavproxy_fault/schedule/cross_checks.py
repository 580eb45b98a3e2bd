"""What the entries of a schedule have to do with each other: their ids, and who waits for whom.

It looks at the data as written, so that an entry which is wrong in itself still counts as there.
"""

import re
from typing import Any

from mavproxy_fault.documents.document_check import DocumentCheck
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.schedule.presets import preset_names, preset_parts

# Ids are parts of keys on the bus: these characters mean something there, as `@` does in front,
# halves of characters cannot be written, and a key may not be long. `all` is every fault.
ID = re.compile(r"(?!@|all\Z)[^/*$?#\ud800-\udfff]{1,200}")
WRONG_ID = "cannot be a key; take up to 200 characters but / * $ ? #, no @ in front, and not `all`"


def default_id(name: str, number: int) -> str:
    """The id of the fault in place `number` of the list (from 0) that gives none itself."""
    return f"{name}-{number + 1}"


def entry_ids(data: dict[str, Any], number: int) -> list[str]:
    """The ids of the entries that one item of the list becomes: several with some presets."""
    preset = data.get("preset")
    if preset not in preset_names():
        return [str(data.get("id") or default_id(str(data.get("fault")), number))]
    whole, parts = data.get("id", preset), len(preset_parts(str(preset)))
    return [f"{whole}.{i + 1}" for i in range(parts)] if parts > 1 else [str(whole)]


def check_id(id: str, where: str) -> None:
    """Refuse an id that no query could name.

    Raises
    ------
    ConfigError
        If it cannot be part of a key.
    """
    if not ID.fullmatch(id):
        raise ConfigError(f"{where}: id = {id[:200]!r} {WRONG_ID}")


def check_together(listed: list[Any], check: DocumentCheck) -> None:
    """Note ids that stand twice, and `after` that names no other fault or goes in a circle."""
    places: dict[str, int] = {}
    for i, item in enumerate(listed):
        for id in entry_ids(item, i) if isinstance(item, dict) else ():
            if id in places:
                check.wrong(("faults", i, "id"), f"= {id} stands twice; ids must differ")
            places.setdefault(id, i)
            if not ID.fullmatch(id):  # no query could name it
                check.wrong(("faults", i, "id"), f"= {id[:200]!r} {WRONG_ID}")
    waits: dict[str, str] = {}
    for i, item in enumerate(listed):
        awaited = _awaited(item.get("after")) if isinstance(item, dict) else None
        if awaited is None:
            continue
        # Waiting for another part of the same item counts as for itself.
        if awaited not in places or places[awaited] == i:
            others = [name for name, place in places.items() if place != i]
            text = f"= {awaited} is no other fault; {suggest_known(awaited, others)}"
            check.wrong(("faults", i, "after"), text)
        else:
            waits.update((id, awaited) for id in entry_ids(item, i) if places[id] == i)
    _check_circles(waits, places, check)


def _awaited(after: Any) -> str | None:
    """The id that an `after` names; None if there is none that could be looked for."""
    name = after.get("id") if isinstance(after, dict) else after
    return name if isinstance(name, str) else None


def _check_circles(waits: dict[str, str], places: dict[str, int], check: DocumentCheck) -> None:
    # Each id is walked once, whatever the number of chains that lead to it.
    done: set[str] = set()
    for first in waits:
        chain: list[str] = []
        id = first
        while id in waits and id not in done:
            done.add(id)
            chain.append(id)
            id = waits[id]
        if id in chain:
            circle = " after ".join([*chain[chain.index(id) :], id])
            text = f"goes in a circle ({circle}); one of them must begin by itself"
            check.wrong(("faults", places[id], "after"), text)
