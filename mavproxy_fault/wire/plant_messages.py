"""Messages to the simulator that set plant faults and faults of the simulated receiver.

A change is sent to the simulator (component 51) in a MAVLink TUNNEL with the payload type below
(types above 32767 are for private use), as JSON in UTF-8:

    {"name": "motor_efficiency[0]", "value": 0.5}     set the fault
    {"name": "motor_efficiency[0]", "value": null}    end it

It is repeated while the fault lasts, so a lost message does no harm. Names are those after `PLANT.`
in a schedule, plus `pseudorange_m[G12]` (metres) and `satellite_lost[G12]` for the receiver.
"""

import math
from functools import lru_cache

import msgspec

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

PAYLOAD_TYPE = 33800  # TUNNEL.payload_type
PAYLOAD_MAX = 128  # bytes of TUNNEL.payload
SIMULATOR = (1, 51)  # system, component
COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER, the sender


class PlantChange(msgspec.Struct, frozen=True):
    """One parameter and its new value; None ends the fault."""

    name: str
    value: float | None


@lru_cache(256)  # it is repeated while a fault lasts
def plant_frame(change: PlantChange, target: tuple[int, int] = SIMULATOR) -> bytes:
    """Encode a change as a TUNNEL frame to a system and component.

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
    return build_frame(message_layout("TUNNEL"), values, component=COMPONENT)


def plant_change(frame: Frame) -> PlantChange | None:
    """Decode the change in a frame; None if it is another message or invalid."""
    if frame.layout.name != "TUNNEL" or frame.number("payload_type") != PAYLOAD_TYPE:
        return None
    start = frame.layout.fields["payload"].offset
    # JSON never ends in a zero byte, so MAVLink 2 has not truncated it.
    data = frame.payload[start : start + int(frame.number("payload_length"))]
    try:
        return msgspec.json.decode(data, type=PlantChange)
    # A peer may send anything: ignore what cannot be decoded.
    except msgspec.MsgspecError:
        return None
