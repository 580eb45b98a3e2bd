"""Parses the `target` of a schedule: fields, messages, satellites or plant parameters.

HIL_SENSOR.xgyro   HIL_ACTUATOR_CONTROLS.controls[3]   HIL_GPS   PSEUDORANGE.G12   PLANT.wind_n_mps
"""

import re
from collections.abc import Iterable

from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.fault_parts.elements import Element, locate_element
from mavproxy_fault.wire.dialect import Layout, find_layout, message_names
from mavproxy_fault.wire.plant_names import SATELLITE_NAME, SATELLITES, check_plant_name

ELEMENT = re.compile(r"(\w+)(?:\[(\d+)\])?")
RANGES = "PSEUDORANGE"
PLANT = "PLANT"
ALL = "all"


def find_message(name: str) -> Layout:
    """Return the layout of a message by name.

    Raises
    ------
    ValueError
        If the dialect does not define it; the text suggests names.
    """
    if name == PLANT:
        text = f"{PLANT} is the simulated plant, not a message; use `fault: plant`"
        raise ValueError(text)
    found = find_layout(name)
    if found is None:
        raise ValueError(f"{name} is not a message; {suggest_known(name, message_names())}")
    return found


def parse_field_targets(targets: Iterable[str]) -> dict[int, tuple[Element, ...]]:
    """Parse `MESSAGE.field` (also an array) and `MESSAGE.field[3]` to elements by message id.

    Raises
    ------
    ValueError
        If a message, field or index does not exist, or the field is text.
    """
    parsed: dict[int, tuple[Element, ...]] = {}
    for target in targets:
        name, _, rest = target.partition(".")
        described = find_message(name)
        before, added = parsed.get(described.id, ()), _elements(described, target, rest)
        if set(before) & set(added):
            raise ValueError(f"{target} is given twice; give it once")
        parsed[described.id] = before + added
    return parsed


def _elements(described: Layout, target: str, rest: str) -> tuple[Element, ...]:
    parts = ELEMENT.fullmatch(rest)
    numeric = [field.name for field in described.fields.values() if field.type != "char"]
    if parts is None or parts[1] not in numeric:
        raise ValueError(
            f"{target} is not a numeric field of {described.name}; {suggest_known(rest, numeric)}"
        )
    field = described.fields[parts[1]]
    if parts[2] is None:
        # An array without an index means all its elements.
        return tuple(locate_element(described, field.name, i) for i in range(max(field.count, 1)))
    if int(parts[2]) >= max(field.count, 1):
        raise ValueError(f"{target} is out of range; give an index below {max(field.count, 1)}")
    return (locate_element(described, field.name, int(parts[2])),)


def parse_message_targets(targets: Iterable[str]) -> frozenset[int]:
    """Parse message names to message ids.

    Raises
    ------
    ValueError
        If a target is not the name of a message.
    """
    ids: set[int] = set()
    for target in targets:
        if "." in target:
            raise ValueError(f"{target} is a field; this fault needs a message")
        if find_message(target).id in ids:
            raise ValueError(f"{target} is given twice; give it once")
        ids.add(find_message(target).id)
    return frozenset(ids)


def parse_named_targets(targets: Iterable[str], prefix: str) -> tuple[str, ...]:
    """Parse the names of satellites or plant parameters after `PSEUDORANGE.` or `PLANT.`.

    Raises
    ------
    ValueError
        If a target has another prefix, or the satellite or parameter does not exist.
    """
    names: list[str] = []
    for target in targets:
        head, _, rest = target.partition(".")
        if head != prefix or not rest:
            raise ValueError(f"{target} does not fit this fault; give {prefix}.<name>")
        if prefix == RANGES and rest == ALL:
            # Each satellite once, if some are also given by name.
            names += [satellite for satellite in SATELLITES if satellite not in names]
            continue
        if prefix == RANGES and not SATELLITE_NAME.fullmatch(rest):
            raise ValueError(
                f"{target} is not a satellite; give {RANGES}.G01 to G32, E01 to E36 or {ALL}"
            )
        if prefix == PLANT:
            check_plant_name(rest)
        if rest in names:
            raise ValueError(f"{target} is given twice; give it once")
        names.append(rest)
    return tuple(names)
