"""Messages to the simulator: what a fault changes in the plant or in its receiver.

A change travels to the simulator (component 51) in MAVLink TUNNEL of the payload type below (types
above 32767 are for private use), as JSON in UTF-8:

    {"name": "motor_efficiency[0]", "value": 0.5}     from now on
    {"name": "motor_efficiency[0]", "value": null}    healthy again

It is repeated while the fault lasts, so a lost one does no harm. Names are those behind `PLANT.` in
a schedule, and `pseudorange_m[G12]` (metres) and `satellite_lost[G12]` for the simulated receiver.
"""

import math

import msgspec

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

PAYLOAD_TYPE = 33800  # TUNNEL.payload_type
PAYLOAD_MAX = 128
SIMULATOR = (1, 51)  # system, component


class PlantChange(msgspec.Struct, frozen=True):
    """One parameter and its value now; None means healthy again."""

    name: str
    value: float | None


def plant_frame(
    change: PlantChange,
    target: tuple[int, int] = SIMULATOR,
    *,
    seq: int = 0,
    system: int = 1,
    component: int = 191,
) -> bytes:
    """The TUNNEL frame that carries a change to a system and component.

    Raises
    ------
    ValueError
        If the name is too long for one TUNNEL, or the value is not finite.
    """
    if change.value is not None and not math.isfinite(change.value):
        raise ValueError(f"{change.name} = {change.value} is not finite")
    payload = msgspec.json.encode(change)
    if len(payload) > PAYLOAD_MAX:
        raise ValueError(f"{change.name} is too long for one TUNNEL")
    values = {
        "payload_type": PAYLOAD_TYPE,
        "target_system": target[0],
        "target_component": target[1],
        "payload_length": len(payload),
        "payload": payload,
    }
    return build_frame(
        message_layout("TUNNEL"), values, seq=seq, system=system, component=component
    )


def plant_change(frame: Frame) -> PlantChange | None:
    """The change that a frame carries; None if it is another message or cannot be read."""
    if frame.layout.name != "TUNNEL" or frame.number("payload_type") != PAYLOAD_TYPE:
        return None
    start = frame.layout.fields["payload"].offset
    # JSON ends in no zero byte, so that MAVLink 2 has cut nothing off it.
    data = frame.payload[start : start + int(frame.number("payload_length"))]
    try:
        return msgspec.json.decode(data, type=PlantChange)
    # A peer's bytes may be anything: what cannot be read changes nothing.
    except msgspec.MsgspecError:
        return None
