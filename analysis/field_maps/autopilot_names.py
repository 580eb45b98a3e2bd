"""Names of what autopilots give as numbers: modes, events, errors, vehicles.

ArduPilot's modes by class of vehicle are the `mode` enumerations in mode.h of each firmware; errors
are LogErrorSubsystem, events some of LogEvent, failsafes the ModeReason of a mode that ArduPilot
entered by itself to protect the vehicle, builds APM_BUILD_TYPE (VER.BU). Navigation states and
types are PX4's (vehicle_status); frames and classes are by MAV_TYPE.
"""

from importlib.resources import files

import msgspec

NAMES = msgspec.json.decode(
    (files(__package__) / "names.json").read_bytes(), type=dict[str, dict[int, str]]
)
