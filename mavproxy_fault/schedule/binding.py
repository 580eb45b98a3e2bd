"""Binds a fault to its target: fields, messages, satellites or the plant."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from mavproxy_fault.fault_parts import target as targets
from mavproxy_fault.fault_parts.fault import Fault
from mavproxy_fault.fault_parts.units import factors_of
from mavproxy_fault.faults.loss import Drop
from mavproxy_fault.faults.plant_fault import ReceiverFault, receiver_names
from mavproxy_fault.faults.registry import acts_on_ranges, known_faults
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.wire.dialect import message_layout

TARGET_FIELDS = ("elements", "factors", "names")  # fields of a fault filled from its target

# The simulator's regular messages, to which plant changes are sent as replies.
CARRIER_IDS = frozenset(
    message_layout(name).id for name in ("HIL_SENSOR", "HIL_STATE_QUATERNION", "HIL_GPS")
)
TUNNEL = frozenset({message_layout("TUNNEL").id})

Ids = frozenset[int] | None


class ResolvedTarget(NamedTuple):
    """A parsed target: fields for the fault, ids of the messages it needs, and satellites."""

    given: dict[str, Any]
    ids: Ids
    satellites: tuple[str, ...] = ()


def resolve_target(name: str, kind: type[Any], names: Sequence[str]) -> ResolvedTarget:
    """Parse the target of a fault.

    Raises
    ------
    ValueError
        If it does not fit the fault or the dialect; the text starts with the target.
    """
    # Pseudoranges cannot be mixed with other targets.
    on_ranges = [target for target in names if target.startswith(targets.RANGES + ".")]
    if on_ranges:
        if not acts_on_ranges(kind):
            capable = ", ".join(n for n, other in known_faults().items() if acts_on_ranges(other))
            raise ValueError(
                f"{on_ranges[0]} is not a target for {name}; for satellites use {capable}"
            )
        return ResolvedTarget({}, TUNNEL, targets.parse_named_targets(names, targets.RANGES))
    # Plant changes are sent in reply to the simulator's frames.
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
        # Faults on encoded bits need no unit conversion.
        factors = {} if getattr(kind, "on_wire", False) else factors_of(elements)
        given = {"elements": elements, "factors": factors}
        return ResolvedTarget(given, frozenset(elements))
    # Without a target, the messages that the fault itself names, if any.
    ids = targets.parse_message_targets(names) or targets.parse_message_targets(
        getattr(kind, "messages", ())
    )
    return ResolvedTarget({}, ids or None)


def target_errors(name: str, kind: type[Any], names: Sequence[str]) -> list[str]:
    """Return the errors of the targets; empty if they are valid."""
    found: list[str] = []
    # Separately first, so that the error names the wrong target; then together.
    for part in [*([target] for target in names), names]:
        if found and part is names:
            break
        try:
            resolve_target(name, kind, part)
        except ValueError as error:
            found.append(str(error))
    return found


def bind_fault(
    kind: type[Any], parameters: dict[str, Any], at: ResolvedTarget, via: str
) -> tuple[Fault, Ids]:
    """Build the fault from its parameters and target; return it with its message ids.

    Raises
    ------
    ValueError
        If the parameters are inconsistent or do not fit the target.
    """
    fault: Any = kind(**parameters, **at.given)
    if not at.satellites:
        if via == "simulator" and kind.acts_on != "plant":
            raise ValueError("via: simulator needs a PSEUDORANGE or PLANT target; remove via")
        return fault, at.ids
    if isinstance(fault, Drop) and (fault.profile is not None or fault.correlation):
        raise ValueError("drop of satellites accepts value only; remove profile and correlation")
    if via == "simulator":
        names = receiver_names(at.satellites, fault)
        return ReceiverFault(names=names, fault=fault), CARRIER_IDS
    return SatelliteFault(fault=fault, names=at.satellites), at.ids
