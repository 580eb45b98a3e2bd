"""Data of the page's fault form: faults, presets, suggested targets, and a preview."""

import math
from functools import cache
from typing import Any

import msgspec

from mavproxy_fault.app.catalogue import first_line, schedule_schema
from mavproxy_fault.app.preview import FaultCurve, preview_curves
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.units import VALUE_UNITS
from mavproxy_fault.faults.registry import acts_on_ranges, known_faults
from mavproxy_fault.schedule.entries import parse_entry
from mavproxy_fault.schedule.presets import preset_names, read_preset
from mavproxy_fault.wire.dialect import message_layout

# Messages whose fields are suggested as targets; any other may be typed.
SUGGESTED_MESSAGES = (
    "HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION", "GLOBAL_POSITION_INT", "GPS_RAW_INT",
    "ATTITUDE", "ATTITUDE_QUATERNION", "VFR_HUD", "RAW_IMU", "SCALED_PRESSURE", "ODOMETRY",
    "DISTANCE_SENSOR", "HIL_ACTUATOR_CONTROLS", "BATTERY_STATUS",
)  # fmt: skip
MAX_POINTS = 600  # pixels of a preview's width


@cache
def fault_catalogue() -> bytes:
    """Faults with their schema, presets with a description, and suggested targets, as JSON."""
    described = schedule_schema()
    # The last choice is that of presets.
    choices = described["properties"]["faults"]["items"]["anyOf"][:-1]
    faults = {
        name: {
            "about": first_line(kind),
            "acts_on": kind.acts_on,
            "unit": VALUE_UNITS.get(name, ""),
            "messages": list(getattr(kind, "messages", ())),
            "on_ranges": acts_on_ranges(kind),
            "schema": choice,
        }
        for (name, kind), choice in zip(known_faults().items(), choices, strict=True)
    }
    presets = {name: read_preset(name)["about"] for name in preset_names()}
    # Of a position one step is 11 mm to the north.
    units = {
        f"{name}.{field.name}": field.unit.replace("degE7", "1e-7 deg")
        for name in SUGGESTED_MESSAGES
        for field in message_layout(name).fields.values()
    }
    return msgspec.json.encode(
        {
            "faults": faults,
            "presets": presets,
            "units": units,
            "defs": described["$defs"],
            "modes": flight_modes(),
        }
    )


def flight_modes() -> dict[str, Any]:
    """Names of flight modes: PX4's by `main.sub`, ArduPilot's by MAV_TYPE and number."""
    from pymavlink import mavutil  # slow to import

    px4 = {f"{main}.{sub}": name.lower() for name, (_, main, sub) in mavutil.px4_map.items()}
    ardupilot = {
        kind: {number: name.lower() for number, name in names.items()}
        for kind, names in mavutil.AP_MAV_TYPE_MODE_MAP.items()
    }
    return {"px4": px4, "ardupilot": ardupilot}


def preview_entry(body: bytes) -> dict[str, Any]:
    """The effect of an entry (JSON) on synthetic fault-free data.

    Raises
    ------
    ConfigError
        If the entry is invalid, with all errors.
    """
    try:
        entry = msgspec.json.decode(body, type=dict[str, Any])
    except msgspec.DecodeError as error:
        raise ConfigError(f"preview: {error}; send an entry as JSON") from None
    parts = parse_entry(entry, "fault")
    return {
        "curves": [thin_curve(curve) for part in parts for curve in preview_curves(part, 0)[:3]]
    }


def thin_curve(curve: FaultCurve) -> dict[str, Any]:
    """A curve thinned for a small plot."""
    # Rounded up, so that no curve exceeds MAX_POINTS.
    step = max(1, math.ceil(len(curve.t_s) / MAX_POINTS))
    return {
        "name": curve.name,
        "t": curve.t_s[::step],
        "healthy": curve.healthy[::step],
        "faulty": curve.faulty[::step],
        "lost": curve.lost[::step],
    }
