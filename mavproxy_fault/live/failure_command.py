"""MAV_CMD_INJECT_FAILURE: the faults on forwarded messages for each failure unit and type.

The standard [1]_ defines no magnitudes, so each unit has default ones that a vehicle notices;
params 4 and 5, which it leaves unused, override magnitude and duration. A unit with its own message
is switched off by dropping that message. A sensor that shares HIL_SENSOR loses its `fields_updated`
bits instead, and its values, not its frames, are delayed or held: that message is also the
vehicle's clock.

References
----------
.. [1] MAVLink common message set, MAV_CMD_INJECT_FAILURE, FAILURE_UNIT, FAILURE_TYPE.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.wire.dialect import message_layout

UNITS = {
    0: "gyro", 1: "accel", 2: "mag", 3: "baro", 4: "gps", 5: "optical-flow", 6: "vio",
    7: "distance", 8: "airspeed", 100: "battery", 101: "motor", 102: "servo", 103: "avoidance",
    104: "rc", 105: "mavlink", 106: "esc", 107: "traffic",
}  # fmt: skip
TYPES = {
    0: "ok", 1: "off", 2: "stuck", 3: "garbage", 4: "wrong", 5: "slow", 6: "delayed",
    7: "intermittent", 8: "drift",
}  # fmt: skip

SIGNED = ("wrong", "drift")
# Default magnitudes, chosen large enough for a vehicle to notice.
SLOW_S = 1.0  # update period of a slow sensor
DELAY_S = 0.5
LINK_HZ = 10.0  # frame rate of a slow link
INTERMITTENT = {"for_s": 0.5, "repeat": {"every_s": 1.0}}

M_PER_HPA = 8.4  # height per pressure at sea level, ISO 2533
DEGE7_PER_M = 90.0  # latitude: one degree is about 111 km


@dataclass(frozen=True, slots=True)
class UnitPart:
    """The fields of one message that belong to a failure unit.

    `fields` are (name, counts per unit of magnitude); `group` is the unit's bit group in
    `fields_updated`; `shared` means that the message carries other units too; `instance` is the
    instance that the message belongs to, 0 if an id or index selects it; in an `indexed` part,
    element i is instance `skipped` + i + 1.
    """

    message: str
    fields: tuple[tuple[str, float], ...] = ()
    group: str = ""
    shared: bool = False
    instance: int = 0
    indexed: bool = False
    skipped: int = 0

    def has(self, instance: int) -> bool:
        """Whether the part contains this instance; 0 means any."""
        if self.indexed and instance:
            elements = [message_layout(self.message).fields[name].count for name, _ in self.fields]
            return 0 < instance - self.skipped <= min(elements)
        return not self.instance or instance in (0, self.instance)


@dataclass(frozen=True, slots=True)
class FailureUnit:
    """The parts of a unit and its default offset (wrong), sigma (noise) and drift per second."""

    parts: tuple[UnitPart, ...]
    wrong: float = 1.0
    noise: float = 1.0
    drift: float = 0.1


def _axes(stem: str, scale: float = 1.0) -> tuple[tuple[str, float], ...]:
    return tuple((f"{axis}{stem}", scale) for axis in "xyz")


def _imu(stem: str, group: str, scaled: float) -> tuple[UnitPart, ...]:
    """Return the parts of an IMU sensor or magnetometer in all messages that carry it."""
    rows = [
        UnitPart("HIL_SENSOR", _axes(stem), group, True),
        UnitPart("HIGHRES_IMU", _axes(stem), "", True),
    ]
    rows += [UnitPart("RAW_IMU", _axes(stem, scaled), "", True)]
    for number, name in enumerate(("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"), 1):
        rows.append(UnitPart(name, _axes(stem, scaled), "", True, number))
    return tuple(rows)


POSITION = (("lat", DEGE7_PER_M), ("lon", DEGE7_PER_M), ("alt", 1000.0))
HEIGHTS = (("abs_pressure", 1.0), ("pressure_alt", -M_PER_HPA))
CONTROLS = (UnitPart("HIL_ACTUATOR_CONTROLS", (("controls", 1.0),), "", True, indexed=True),)

FAILURE_UNITS: dict[str, FailureUnit] = {
    "gyro": FailureUnit(_imu("gyro", "gyro", 1000.0), 0.5, 1.0, 0.02),
    "accel": FailureUnit(_imu("acc", "accel", 1000.0 / STANDARD_GRAVITY_MPS2), 3.0, 5.0, 0.2),
    "mag": FailureUnit(_imu("mag", "mag", 1000.0), 0.3, 0.3, 0.02),
    "baro": FailureUnit((
        UnitPart("HIL_SENSOR", HEIGHTS, "baro", True),
        UnitPart("HIGHRES_IMU", HEIGHTS, "", True),
        UnitPart("SCALED_PRESSURE", (("press_abs", 1.0),), "", True, 1),
        UnitPart("SCALED_PRESSURE2", (("press_abs", 1.0),), "", True, 2),
    ), 5.0, 5.0, 0.12),
    "gps": FailureUnit((
        UnitPart("HIL_GPS", POSITION),
        UnitPart("GPS_INPUT", (*POSITION[:2], ("alt", 1.0))),
        UnitPart("GPS_RAW_INT", POSITION, instance=1),
        UnitPart("GPS2_RAW", POSITION, instance=2),
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
    "distance": FailureUnit((UnitPart("DISTANCE_SENSOR", (("current_distance", 100.0),)),), 5.0,
    2.0, 0.2), "airspeed": FailureUnit((
        UnitPart("HIL_SENSOR", (("diff_pressure", 1.0),), "airspeed", True),
        UnitPart("HIGHRES_IMU", (("diff_pressure", 1.0),), "", True),
        UnitPart("SCALED_PRESSURE", (("press_diff", 1.0),), "", True, 1),
    ), 2.0, 1.0, 0.05),
    "battery": FailureUnit((
        UnitPart("BATTERY_STATUS", (("voltages[0]", 1000.0),)),
        UnitPart("SYS_STATUS", (("voltage_battery", 1000.0),), "", True),
    ), -3.0, 1.0, -0.05),
    "motor": FailureUnit(CONTROLS, -0.3, 0.2, -0.02),
    "servo": FailureUnit(CONTROLS, 0.3, 0.2, 0.02),
    "avoidance": FailureUnit((UnitPart("OBSTACLE_DISTANCE", (("distances", 100.0),)),), -2.0, 2.0,
    -0.2), "rc": FailureUnit((
        UnitPart("RC_CHANNELS", tuple((f"chan{n}_raw", 1.0) for n in range(1, 9))),
        UnitPart("RC_CHANNELS_OVERRIDE", tuple((f"chan{n}_raw", 1.0) for n in range(1, 9))),
        UnitPart("MANUAL_CONTROL", (("x", 2.0), ("y", 2.0), ("z", 2.0), ("r", 2.0))),
    ), 200.0, 100.0, 20.0),
    "mavlink": FailureUnit(()),  # the link itself: every message
    "esc": FailureUnit((
        UnitPart("ESC_TELEMETRY_1_TO_4", (("rpm", 1.0),), "", True, indexed=True),
        UnitPart("ESC_TELEMETRY_5_TO_8", (("rpm", 1.0),), "", True, indexed=True, skipped=4),
        # 10,000 rpm
        UnitPart("HIL_ACTUATOR_CONTROLS", (("controls", 1e-4),), "", True, indexed=True),
    ), 1000.0, 500.0, 50.0),
    "traffic": FailureUnit((
        UnitPart("ADSB_VEHICLE", (*POSITION[:2], ("altitude", 1000.0))),
    ), 5000.0, 500.0, 50.0),
}  # fmt: skip
MESSAGES = frozenset(part.message for unit in FAILURE_UNITS.values() for part in unit.parts)


def failure_id(unit: str, instance: int) -> str:
    """Return the id of a failure's faults; a second failure of a unit replaces the first."""
    return f"mav-{unit}-{instance}" if instance else f"mav-{unit}"


@dataclass(frozen=True, slots=True)
class Extent:
    """Magnitude and duration; None means the unit's default, and no end."""

    magnitude: float | None = None
    for_s: float | None = None

    def of(self, usual: float) -> float:
        """Return the magnitude, or the default."""
        return usual if self.magnitude is None else self.magnitude


def extent_of(kind: str, given: Sequence[float]) -> Extent:
    """Read magnitude and duration from params 4 and 5.

    0 means "not given", like NaN: senders leave unused params at 0. Only an offset and a drift
    have a sign.
    """
    magnitude, for_s = [
        value if math.isfinite(value) and value != 0.0 else None for value in (*given, 0.0, 0.0)[:2]
    ]
    if magnitude is not None and kind not in SIGNED:
        magnitude = abs(magnitude)
    return Extent(magnitude, for_s if for_s is not None and for_s > 0.0 else None)


def faults_for(
    unit: str, kind: str, instance: int, passed: Collection[str], extent: Extent = Extent()
) -> list[dict[str, Any]]:
    """Return the schedule entries that apply a failure to the messages seen so far.

    Parameters
    ----------
    unit, kind : str
        Failure unit and type by name; any type but `ok`.
    instance : int
        1 for the first sensor or motor, 0 for all.
    passed : collection of str
        Names of the messages seen so far.
    extent : Extent
        Magnitude in the unit's measure, or in seconds for slow and delayed.

    Returns
    -------
    list of dict
        Empty if no message of the unit has passed.
    """
    if unit == "mavlink":
        entry = {"id": f"{failure_id(unit, instance)}.1", **_link_fault(kind, extent)}
        return [_with_duration(entry, extent)] if passed else []
    # Parts of other instances are not affected.
    chosen = [p for p in FAILURE_UNITS[unit].parts if p.message in passed and p.has(instance)]
    entries = []
    for number, part in enumerate(chosen, 1):
        fault = _part_fault(FAILURE_UNITS[unit], part, kind, instance, extent)
        entry = _with_duration(fault, extent)
        if instance and not part.instance and not part.indexed:
            # Instances in the command count from 1, ids in the messages from 0.
            entry["where"] = {"id": instance - 1}
        entries.append({"id": f"{failure_id(unit, instance)}.{number}", **entry})
    return entries


def _with_duration(entry: dict[str, Any], extent: Extent) -> dict[str, Any]:
    """Add the duration to an entry; an intermittent one has its own."""
    if extent.for_s is None or "repeat" in entry:
        return entry
    return {**entry, "for_s": extent.for_s}


def _link_fault(kind: str, extent: Extent) -> dict[str, Any]:
    faults: dict[str, dict[str, Any]] = {
        "off": {"fault": "outage"},
        "stuck": {"fault": "outage"},
        "garbage": {"fault": "corrupt", "count": 3},
        "wrong": {"fault": "corrupt", "crc": "redone"},
        "slow": {"fault": "rate-limit", "value": 1.0 / extent.of(1.0 / LINK_HZ)},
        "delayed": {"fault": "delay", "value": extent.of(DELAY_S)},
        "intermittent": {"fault": "outage", **INTERMITTENT},
        "drift": {"fault": "jitter", "value": extent.of(DELAY_S)},
    }
    return faults[kind]


def _part_fault(
    unit: FailureUnit, part: UnitPart, kind: str, instance: int, extent: Extent
) -> dict[str, Any]:
    if kind == "intermittent":
        return {**_part_fault(unit, part, "off", instance, extent), **INTERMITTENT}
    # A message that carries only this unit can be dropped or delayed as a frame.
    if not part.shared and kind in ("off", "slow", "delayed"):
        faults: dict[str, dict[str, Any]] = {
            "off": {"fault": "drop"},
            "slow": {"fault": "rate-limit", "value": 1.0 / extent.of(SLOW_S)},
            "delayed": {"fault": "delay", "value": extent.of(DELAY_S)},
        }
        return {"target": part.message, **faults[kind]}
    if kind == "off" and part.group:
        flags = f"{part.message}.fields_updated"
        return {"fault": "clear-bits", "target": flags, "groups": [part.group]}
    fields, scales = _elements(part, instance)
    target: dict[str, Any] = {"target": fields}
    if kind == "off":
        # A shared message without flags: zero is the closest to no data.
        return {**target, "fault": "constant", "value": 0.0}
    if kind == "stuck":
        return {**target, "fault": "freeze"}
    if kind == "slow":
        return {**target, "fault": "sample-hold", "value": extent.of(SLOW_S)}
    if kind == "delayed":
        return {**target, "fault": "lag", "value": extent.of(DELAY_S)}
    if kind == "garbage":
        return {
            **target,
            "fault": "noise",
            "value": [extent.of(unit.noise) * abs(s) for s in scales],
        }
    if kind == "wrong":
        return {**target, "fault": "bias", "value": [extent.of(unit.wrong) * s for s in scales]}
    return {**target, "fault": "drift", "value": [extent.of(unit.drift) * s for s in scales]}


def _elements(part: UnitPart, instance: int) -> tuple[list[str], list[float]]:
    """Return the targets of a part and the scale of each of their elements."""
    from mavproxy_fault.fault_parts.target import parse_field_targets

    targets: list[str] = []
    scales: list[float] = []
    for name, scale in part.fields:
        chosen = f"[{instance - 1 - part.skipped}]" if part.indexed and instance else ""
        targets.append(f"{part.message}.{name}{chosen}")
        # One scale per element of an array field.
        (elements,) = parse_field_targets([targets[-1]]).values()
        scales += [scale] * len(elements)
    return targets, scales
