"""The parameter service: PX4's parameter names with bytewise encoding.

An integer is sent as its four bytes in place of the float, as PX4 does and announces by
MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE [1]_.

References
----------
.. [1] MAVLink developer guide, "Parameter Protocol", "Parameter Encoding".
"""

import math
import struct
from collections.abc import Mapping

from mavproxy_fault.wire.frame import Frame
from simvehicle.autopilot.enums import PARAM_INT32, PARAM_REAL32
from simvehicle.hil.hil_messages import Message, make_message

# Meaning and defaults follow PX4's parameter reference, adapted to this vehicle.
COMMON_PARAMETERS: dict[str, int | float] = {
    "BAT1_N_CELLS": 4,
    "CAL_ACC0_ID": 1310988,
    "CAL_GYRO0_ID": 1310988,
    "CAL_MAG0_ID": 197388,
    "COM_DISARM_LAND": 2.0,  # s on the ground after a landing
    "COM_RC_IN_MODE": 4,  # no stick input
    "MAV_COMP_ID": 1,
    "MAV_SYS_ID": 1,
    "MIS_TAKEOFF_ALT": 10.0,  # m above home
    "NAV_ACC_RAD": 2.0,  # m, acceptance radius of a waypoint
    "RTL_RETURN_ALT": 30.0,  # m above home
    "SYS_FAILURE_EN": 0,  # 1 enables MAV_CMD_INJECT_FAILURE
}


class Parameters:
    """The vehicle's parameters by name; the type of a value never changes."""

    def __init__(self, more: Mapping[str, int | float] = {}) -> None:
        self._values = dict(sorted({**COMMON_PARAMETERS, **more}.items()))
        self._names = list(self._values)

    def __getitem__(self, name: str) -> int | float:
        return self._values[name]

    def received(self, frame: Frame) -> list[Message]:
        """Answer PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET."""
        if frame.layout.name == "PARAM_REQUEST_LIST":
            return [self._value(name) for name in self._names]
        if frame.layout.name == "PARAM_REQUEST_READ":
            name = self._requested_name(frame)
            return [self._value(name)] if name in self._values else []
        return self._set(frame)

    def _requested_name(self, frame: Frame) -> str:
        index = int(frame.number("param_index"))
        if index < 0:
            # A negative index selects by name.
            return _parameter_name(frame)
        return self._names[index] if index < len(self._names) else ""

    def _set(self, frame: Frame) -> list[Message]:
        """Set a value of the right type; returns the value now in force."""
        name = _parameter_name(frame)
        if name not in self._values:
            return []
        integer = isinstance(self._values[name], int)
        sent_type = frame.number("param_type")
        value = frame.number("param_value")
        # Bytewise encoding: the float's bytes are the integer's.
        if integer and sent_type == PARAM_INT32:
            self._values[name] = struct.unpack("<i", struct.pack("<f", value))[0]
        elif not integer and sent_type == PARAM_REAL32 and math.isfinite(value):
            self._values[name] = float(value)
        # Also after a refusal: PARAM_VALUE reports the unchanged value.
        return [self._value(name)]

    def _value(self, name: str) -> Message:
        value = self._values[name]
        integer = isinstance(value, int)
        return make_message(
            "PARAM_VALUE",
            param_id=name.encode(),
            # Bytewise encoding, in the other direction.
            param_value=struct.unpack("<f", struct.pack("<i", value))[0] if integer else value,
            param_type=PARAM_INT32 if integer else PARAM_REAL32,
            param_count=len(self._names),
            param_index=self._names.index(name),
        )


def _parameter_name(frame: Frame) -> str:
    name = frame.read("param_id")
    return name.decode("ascii", "replace") if isinstance(name, bytes) else ""
