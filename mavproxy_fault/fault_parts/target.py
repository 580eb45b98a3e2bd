"""What a schedule's `target` names: fields, whole messages, satellites or plant parameters.

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
    """The layout of a message by name.

    Raises
    ------
    ValueError
        If the dialect has none of that name; the text suggests others.
    """
    if name == PLANT:
        text = f"{PLANT} is the simulated plant and no message; `fault: plant` changes it"
        raise ValueError(text)
    found = find_layout(name)
    if found is None:
        raise ValueError(f"{name} is no message; {suggest_known(name, message_names())}")
    return found


def parse_field_targets(targets: Iterable[str]) -> dict[int, tuple[Element, ...]]:
    """The elements that `MESSAGE.field`, `MESSAGE.field[3]` or whole arrays name, by message id.

    Raises
    ------
    ValueError
        If a message, a field or an index does not exist, or the field holds text.
    """
    found: dict[int, tuple[Element, ...]] = {}
    for target in targets:
        name, _, rest = target.partition(".")
        described = find_message(name)
        before, more = found.get(described.id, ()), _elements(described, target, rest)
        # The same element twice would be changed twice.
        if set(before) & set(more):
            raise ValueError(f"{target} is named twice; once is enough")
        found[described.id] = before + more
    return found


def _elements(described: Layout, target: str, rest: str) -> tuple[Element, ...]:
    parts = ELEMENT.fullmatch(rest)
    numeric = [field.name for field in described.fields.values() if field.type != "char"]
    if parts is None or parts[1] not in numeric:
        raise ValueError(
            f"{target} is no numeric field of {described.name}; {suggest_known(rest, numeric)}"
        )
    field = described.fields[parts[1]]
    if parts[2] is None:
        # A whole array stands for all its elements.
        return tuple(locate_element(described, field.name, i) for i in range(max(field.count, 1)))
    if int(parts[2]) >= max(field.count, 1):
        raise ValueError(f"{target} is out of range; {field.name} has {max(field.count, 1)}")
    return (locate_element(described, field.name, int(parts[2])),)


def parse_message_targets(targets: Iterable[str]) -> frozenset[int]:
    """The ids of whole messages.

    Raises
    ------
    ValueError
        If a target is not the name of a message.
    """
    ids: set[int] = set()
    for target in targets:
        if "." in target:
            raise ValueError(f"{target} names a field; this fault acts on whole messages")
        if find_message(target).id in ids:
            raise ValueError(f"{target} is named twice; once is enough")
        ids.add(find_message(target).id)
    return frozenset(ids)


def parse_named_targets(targets: Iterable[str], prefix: str) -> tuple[str, ...]:
    """What stands behind `PSEUDORANGE.` or `PLANT.`.

    Raises
    ------
    ValueError
        If a target has another prefix, or names no satellite or parameter that there is.
    """
    names: list[str] = []
    for target in targets:
        head, _, rest = target.partition(".")
        if head != prefix or not rest:
            raise ValueError(f"{target} is wrong here; it must be {prefix}.<name>")
        if prefix == RANGES and rest == ALL:
            # Beside names that stand there already: each satellite once.
            names += [satellite for satellite in SATELLITES if satellite not in names]
            continue
        if prefix == RANGES and not SATELLITE_NAME.fullmatch(rest):
            raise ValueError(
                f"{target} names no satellite; {RANGES}.G01 to G32, E01 to E36 and {ALL} do"
            )
        if prefix == PLANT:
            check_plant_name(rest)
        if rest in names:
            raise ValueError(f"{target} is named twice; once is enough")
        names.append(rest)
    return tuple(names)
