"""How a fault and what it acts on become one: fields, whole messages, satellites or the plant."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from mavproxy_fault.fault_parts import target as targets
from mavproxy_fault.fault_parts.fault import Fault
from mavproxy_fault.fault_parts.units import factors_of
from mavproxy_fault.faults.plant_fault import ReceiverFault, receiver_names
from mavproxy_fault.faults.registry import acts_on_ranges, known_faults
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.wire.dialect import message_layout

TARGET_FIELDS = ("elements", "factors", "names")  # fields of a fault that come from its target

# What carries messages to the simulator along: whatever it sends regularly.
CARRIER_IDS = frozenset(
    message_layout(name).id for name in ("HIL_SENSOR", "HIL_STATE_QUATERNION", "HIL_GPS")
)
TUNNEL = frozenset({message_layout("TUNNEL").id})

Ids = frozenset[int] | None


class ResolvedTarget(NamedTuple):
    """A target understood: what the fault is given, the messages it must see, the satellites."""

    given: dict[str, Any]
    ids: Ids
    satellites: tuple[str, ...] = ()


def resolve_target(name: str, kind: type[Any], names: Sequence[str]) -> ResolvedTarget:
    """What the target of a fault means.

    Raises
    ------
    ValueError
        If it fits the fault or the dialect in no way; the text starts with the target.
    """
    # All or none: a fault acts on ranges or on something else.
    on_ranges = [one for one in names if one.startswith(targets.RANGES + ".")]
    if on_ranges:
        if not acts_on_ranges(kind):
            able = ", ".join(one for one, kind in known_faults().items() if acts_on_ranges(kind))
            raise ValueError(f"{on_ranges[0]} is no target for {name}; satellites take {able}")
        return ResolvedTarget({}, TUNNEL, targets.parse_named_targets(names, targets.RANGES))
    # A plant change travels in answers to the simulator, so it needs its frames.
    if kind.acts_on == "plant":
        if not names:
            raise ValueError("is missing; give PLANT.<parameter>, for example PLANT.mass_kg_add")
        return ResolvedTarget(
            {"names": targets.parse_named_targets(names, targets.PLANT)}, CARRIER_IDS
        )
    if kind.acts_on == "fields":
        if not names:
            raise ValueError("is missing; give MESSAGE.field, for example HIL_SENSOR.xgyro")
        elements = targets.parse_field_targets(names)
        # What a fault does to the bits on the wire is the same in every unit.
        factors = {} if getattr(kind, "on_wire", False) else factors_of(elements)
        given = {"elements": elements, "factors": factors}
        return ResolvedTarget(given, frozenset(elements))
    # Without a target: the messages that the fault itself names, if it does.
    ids = targets.parse_message_targets(names) or targets.parse_message_targets(
        getattr(kind, "messages", ())
    )
    return ResolvedTarget({}, ids or None)


def target_errors(name: str, kind: type[Any], names: Sequence[str]) -> list[str]:
    """What is wrong with each of the targets; empty if they are right."""
    found: list[str] = []
    # One by one first, so that the error names the very target that is wrong.
    for part in [[one] for one in names] or [[]]:
        try:
            resolve_target(name, kind, part)
        except ValueError as error:
            found.append(str(error))
    if not found:
        try:
            resolve_target(name, kind, names)
        except ValueError as error:  # right one by one, but not together
            found.append(str(error))
    return found


def bind_fault(
    kind: type[Any], parameters: dict[str, Any], at: ResolvedTarget, via: str
) -> tuple[Fault, Ids]:
    """The fault with its parameters and target, and the messages it must see.

    Raises
    ------
    ValueError
        If the parameters do not fit each other or the target.
    """
    fault: Any = kind(**parameters, **at.given)
    if not at.satellites:
        if via == "simulator" and kind.acts_on != "plant":
            raise ValueError("via: simulator is for PSEUDORANGE and PLANT targets only")
        return fault, at.ids
    if via == "simulator":
        names = receiver_names(at.satellites, fault)
        # The simulator's own frames carry the changes to it.
        return ReceiverFault(names=names, fault=fault), CARRIER_IDS
    return SatelliteFault(fault=fault, names=at.satellites), at.ids
