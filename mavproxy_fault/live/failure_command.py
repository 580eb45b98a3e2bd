"""MAV_CMD_INJECT_FAILURE: the faults on the autopilot's inputs for each failure unit and type.

Only messages that an autopilot reads, or that move its simulated vehicle, are changed: a fault of
telemetry would show a failure that the vehicle does not have. The standard [1]_ defines no
magnitudes, so each unit has default ones that a vehicle notices. A unit with its own message is
switched off by dropping that message. A sensor that shares HIL_SENSOR loses its `fields_updated`
bits instead, and its values, not its frames, are delayed or held: that message is also the
vehicle's clock.

References
----------
.. [1] MAVLink common message set, MAV_CMD_INJECT_FAILURE, FAILURE_UNIT, FAILURE_TYPE; instance
   bitmask: mavlink pull request 2524; units and types from 107 and 8 on: 2543, 2562.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

UNITS = {
    0: "gyro", 1: "accel", 2: "mag", 3: "baro", 4: "gps", 5: "optical-flow", 6: "vio",
    7: "distance", 8: "airspeed", 100: "battery", 101: "motor", 102: "servo", 103: "avoidance",
    104: "rc", 105: "mavlink", 106: "esc", 107: "traffic", 108: "datalink", 109: "can-bus",
    110: "i2c-bus",
}  # fmt: skip
TYPES = {
    0: "ok", 1: "off", 2: "stuck", 3: "garbage", 4: "wrong", 5: "slow", 6: "delayed",
    7: "intermittent", 8: "drift",
}  # fmt: skip
LINK_UNITS = ("mavlink", "datalink")  # the link itself: every message
NOT_GIVEN = (0.0, float(0x7FFFFFFF))  # and NaN; the second is NaN of COMMAND_INT's integers
ALL_INSTANCES = 0xFFFF  # PX4 takes this bitmask for all instances

# Default magnitudes, chosen large enough for a vehicle to notice.
SLOW_S = 1.0  # update period of a slow sensor
DELAY_S = 0.5
LINK_HZ = 10.0  # frame rate of a slow link
INTERMITTENT = {"for_s": 0.5, "repeat": {"every_s": 1.0}}

LINK_FAULTS: dict[str, dict[str, Any]] = {  # by failure type
    "off": {"fault": "outage"},
    "stuck": {"fault": "outage"},
    "garbage": {"fault": "corrupt", "count": 3},
    "wrong": {"fault": "corrupt", "crc": "redone"},
    "slow": {"fault": "rate-limit", "value": LINK_HZ},
    "delayed": {"fault": "delay", "value": DELAY_S},
    "intermittent": {"fault": "outage", **INTERMITTENT},
    "drift": {"fault": "jitter", "value": DELAY_S},
}
M_PER_HPA = 8.4  # height per pressure at sea level, ISO 2533
DEGE7_PER_M = 90.0  # latitude: one degree is about 111 km


@dataclass(frozen=True, slots=True)
class UnitPart:
    """The fields of one message that belong to a failure unit.

    `fields` are (name, counts per unit of magnitude); `group` is the unit's bit group in
    `fields_updated`; `shared` means that the message carries other units too; in an `indexed` part,
    element i is instance i + 1.
    """

    message: str
    fields: tuple[tuple[str, float], ...] = ()
    group: str = ""
    shared: bool = False
    indexed: bool = False


@dataclass(frozen=True, slots=True)
class FailureUnit:
    """The parts of a unit and its default offset (wrong), sigma (noise) and drift per second."""

    parts: tuple[UnitPart, ...]
    wrong: float = 1.0
    noise: float = 1.0
    drift: float = 0.1


def _axes(stem: str, scale: float = 1.0) -> tuple[tuple[str, float], ...]:
    return tuple((f"{axis}{stem}", scale) for axis in "xyz")


def _hil(group: str, *fields: tuple[str, float]) -> tuple[UnitPart, ...]:
    """Return the part of a sensor that shares HIL_SENSOR."""
    return (UnitPart("HIL_SENSOR", fields, group, True),)


POSITION = (("lat", DEGE7_PER_M), ("lon", DEGE7_PER_M), ("alt", 1000.0))
CONTROLS = (UnitPart("HIL_ACTUATOR_CONTROLS", (("controls", 1.0),), "", True, indexed=True),)

FAILURE_UNITS: dict[str, FailureUnit] = {
    "gyro": FailureUnit(_hil("gyro", *_axes("gyro")), 0.5, 1.0, 0.02),
    "accel": FailureUnit(_hil("accel", *_axes("acc")), 3.0, 5.0, 0.2),
    "mag": FailureUnit(_hil("mag", *_axes("mag")), 0.3, 0.3, 0.02),
    "baro": FailureUnit(
        _hil("baro", ("abs_pressure", 1.0), ("pressure_alt", -M_PER_HPA)), 5.0, 5.0, 0.12
    ),
    "gps": FailureUnit((
        UnitPart("HIL_GPS", POSITION),
        UnitPart("GPS_INPUT", (*POSITION[:2], ("alt", 1.0))),
    ), 200.0, 100.0, 2.0),
    "optical-flow": FailureUnit((
        UnitPart("HIL_OPTICAL_FLOW", (("integrated_x", 1.0), ("integrated_y", 1.0))),
        UnitPart("OPTICAL_FLOW_RAD", (("integrated_x", 1.0), ("integrated_y", 1.0))),
        UnitPart("OPTICAL_FLOW", (("flow_x", 100.0), ("flow_y", 100.0))),
    ), 0.2, 0.2, 0.02),
    "vio": FailureUnit((
        UnitPart("ODOMETRY", _axes("")),
        UnitPart("VISION_POSITION_ESTIMATE", _axes("")),
    ), 5.0, 2.0, 0.5),
    "distance": FailureUnit(
        (UnitPart("DISTANCE_SENSOR", (("current_distance", 100.0),)),), 5.0, 2.0, 0.2
    ),
    "airspeed": FailureUnit(_hil("airspeed", ("diff_pressure", 1.0)), 2.0, 1.0, 0.05),
    "battery": FailureUnit(
        (UnitPart("BATTERY_STATUS", (("voltages[0]", 1000.0),)),), -3.0, 1.0, -0.05
    ),
    "motor": FailureUnit(CONTROLS, -0.3, 0.2, -0.02),
    "servo": FailureUnit(CONTROLS, 0.3, 0.2, 0.02),
    "avoidance": FailureUnit(
        (UnitPart("OBSTACLE_DISTANCE", (("distances", 100.0),)),), -2.0, 2.0, -0.2
    ),
    "rc": FailureUnit((
        UnitPart("RC_CHANNELS", tuple((f"chan{n}_raw", 1.0) for n in range(1, 9))),
        UnitPart("RC_CHANNELS_OVERRIDE", tuple((f"chan{n}_raw", 1.0) for n in range(1, 9))),
        UnitPart("MANUAL_CONTROL", (("x", 2.0), ("y", 2.0), ("z", 2.0), ("r", 2.0))),
    ), 200.0, 100.0, 20.0),
    "traffic": FailureUnit((
        UnitPart("ADSB_VEHICLE", (*POSITION[:2], ("altitude", 1000.0))),
    ), 5000.0, 500.0, 50.0),
}  # fmt: skip
PARTS: dict[str, list[UnitPart]] = {}  # by message
for _unit in FAILURE_UNITS.values():
    for _part in _unit.parts:
        PARTS.setdefault(_part.message, []).append(_part)
# An autopilot never sends these (or, the last one, only to its simulated vehicle); the other
# messages of `PARTS` are telemetry if they come from the vehicle.
INPUTS = frozenset({
    "HIL_SENSOR", "HIL_GPS", "HIL_OPTICAL_FLOW", "GPS_INPUT", "RC_CHANNELS_OVERRIDE",
    "MANUAL_CONTROL", "HIL_ACTUATOR_CONTROLS",
})  # fmt: skip
# The telemetry in which a failure of such an input shows.
TELEMETRY = {
    "HIL_SENSOR": "HIGHRES_IMU", "HIL_GPS": "GPS_RAW_INT", "HIL_OPTICAL_FLOW": "OPTICAL_FLOW_RAD"
}  # fmt: skip
FURTHER_IMUS = {2: "SCALED_IMU2", 3: "SCALED_IMU3"}


@dataclass(frozen=True, slots=True)
class FailureRequest:
    """A failure command: unit and type by name ("" if unknown), and what it addresses.

    `instances` count from 1; empty means all, None that the parameters contradict the standard.
    """

    unit: str
    kind: str
    instances: tuple[int, ...] | None

    @staticmethod
    def read(command: Frame) -> "FailureRequest":
        """Read a COMMAND_LONG or COMMAND_INT."""
        unit, kind, instance, mask = (float(command.number(f"param{n}")) for n in range(1, 5))
        known = UNITS.get(_whole(unit), ""), TYPES.get(_whole(kind), "")
        # COMMAND_INT has integer coordinates in place of params 5 and 6.
        names = (
            ("param5", "param6", "param7") if "param5" in command.layout.fields else tuple("xyz")
        )
        further = [float(command.number(name)) for name in names]
        # As in PX4, an undeclared parameter must not be given.
        if not all(math.isnan(value) or value in NOT_GIVEN for value in further):
            return FailureRequest(*known, None)
        if not math.isnan(instance):
            number = _whole(instance)
            found = None if number < 0 else (number,) if number else ()
            return FailureRequest(*known, found)
        bits = _whole(mask)
        if bits <= 0:  # NaN too: neither parameter is given
            return FailureRequest(*known, None)
        chosen = tuple(i + 1 for i in range(bits.bit_length()) if bits >> i & 1)
        return FailureRequest(*known, () if bits == ALL_INSTANCES else chosen)

    @property
    def name(self) -> str:
        """Unit and type, such as `gyro-off`."""
        return f"{self.unit or 'unit'}-{self.kind or 'failure'}"


def _whole(value: float) -> int:
    """Return a parameter as an integer; -1 if it is none, which is neither a unit nor a type."""
    return int(value) if math.isfinite(value) and value == int(value) else -1


def reaches_autopilot(message: str, direction: str) -> bool:
    """Whether a change of this message reaches the autopilot, and not only its telemetry."""
    return message in INPUTS or direction == "to-vehicle"


def telemetry_targets(request: FailureRequest) -> tuple[str, ...]:
    """Return the fields of telemetry in which the autopilot's own failure shows."""
    unit = FAILURE_UNITS.get(request.unit)
    if unit is None:
        return ()
    part = unit.parts[0]
    if part.indexed:
        numbers = [f"[{instance - 1}]" for instance in request.instances or ()] or [""]
        return tuple(f"{part.message}.{name}{n}" for name, _ in part.fields for n in numbers)
    first = TELEMETRY.get(part.message, part.message)
    found: list[str] = []
    for instance in request.instances or (1,):
        # PX4 and ArduPilot send the first IMU in several messages, and others in their own.
        message = FURTHER_IMUS.get(instance, first) if part.message == "HIL_SENSOR" else first
        names = [name for name, _ in part.fields if name in message_layout(message).fields]
        found += [f"{message}.{name}" for name in names] or [message]
    return tuple(found)


def failure_entries(
    id: str,
    request: FailureRequest,
    instance: int,
    parts: Sequence[tuple[UnitPart, dict[str, Any]]],
) -> list[dict[str, Any]]:
    """Return the schedule entries `id.1`, `id.2`, ... of a failure, one for each part.

    It has any type but `ok`; `instance` counts from 1, 0 is all. A part comes with the `where` of
    its frames.
    """
    entries = []
    for number, (part, where) in enumerate(parts, 1):
        if request.unit in LINK_UNITS:
            entry = LINK_FAULTS[request.kind]
        else:
            entry = _part_fault(FAILURE_UNITS[request.unit], part, request.kind, instance)
        if instance and part.fields and not part.indexed and message_layout(part.message).instance:
            # Instances in the command count from 1, ids in the messages from 0.
            where = {**where, "id": instance - 1}
        entries.append({"id": f"{id}.{number}", **entry, **({"where": where} if where else {})})
    return entries


def _part_fault(unit: FailureUnit, part: UnitPart, kind: str, instance: int) -> dict[str, Any]:
    if kind == "intermittent":
        return {**_part_fault(unit, part, "off", instance), **INTERMITTENT}
    # A message that carries only this unit can be dropped or delayed as a frame.
    if not part.shared and kind in ("off", "slow", "delayed"):
        faults: dict[str, dict[str, Any]] = {
            "off": {"fault": "drop"},
            "slow": {"fault": "rate-limit", "value": 1.0 / SLOW_S},
            "delayed": {"fault": "delay", "value": DELAY_S},
        }
        return {"target": part.message, **faults[kind]}
    if kind == "off" and part.group:
        flags = f"{part.message}.fields_updated"
        return {"fault": "clear-bits", "target": flags, "groups": [part.group]}
    fields, scales = _elements(part, instance)
    by_kind: dict[str, dict[str, Any]] = {
        # A shared message without flags: zero is the closest to no data.
        "off": {"fault": "constant", "value": 0.0},
        "stuck": {"fault": "freeze"},
        "slow": {"fault": "sample-hold", "value": SLOW_S},
        "delayed": {"fault": "lag", "value": DELAY_S},
        "garbage": {"fault": "noise", "value": [unit.noise * abs(s) for s in scales]},
        "wrong": {"fault": "bias", "value": [unit.wrong * s for s in scales]},
        "drift": {"fault": "drift", "value": [unit.drift * s for s in scales]},
    }
    return {"target": fields, **by_kind[kind]}


def _elements(part: UnitPart, instance: int) -> tuple[list[str], list[float]]:
    """Return the targets of a part and the scale of each of their elements."""
    from mavproxy_fault.fault_parts.target import parse_field_targets

    targets: list[str] = []
    scales: list[float] = []
    for name, scale in part.fields:
        chosen = f"[{instance - 1}]" if part.indexed and instance else ""
        targets.append(f"{part.message}.{name}{chosen}")
        # One scale per element of an array field.
        (elements,) = parse_field_targets([targets[-1]]).values()
        scales += [scale] * len(elements)
    return targets, scales
