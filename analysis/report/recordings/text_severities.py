"""Severities of ArduPilot's messages before 2015 (Copter 3.3, Plane 3.4), which are not MAVLink's.

They counted up: low, medium, high, critical, answer to a user (gcs_severity in GCS_MAVLink.h). The
same number means an alert in one version and a greeting in another.
"""

import re
from collections.abc import Sequence

# gcs_severity to MAV_SEVERITY; "high" covers "ARMING MOTORS" and "Low Battery!": text decides.
OLD_SEVERITIES = {1: 6, 2: 5, 3: 4, 4: 3, 5: 6}
FIRST_NEW = {"copter": (3, 4), "plane": (3, 5), "rover": (3, 0)}  # versions with MAV_SEVERITY
VERSION = re.compile(r"(?:ardu|apm:?)(copter|plane|rover)2? v(\d+)\.(\d+)", re.IGNORECASE)
# What no version reports as an alert or as critical.
GREETINGS = re.compile(
    r"^(reached (command|waypoint|home)|command received|flight plan|initiali[sz]ing|ground start"
    r"|calibrating|ready to|zero airspeed|beginning ins|erasing logs|free ram|frame:|resetting)",
    re.IGNORECASE,
)
MEDIUM = 2


def has_old_severities(texts: Sequence[tuple[int, str]]) -> bool:
    """Whether the (severity, text) of an ArduPilot's log use the old severities."""
    for _, text in texts:
        if (version := VERSION.search(text)) is not None:
            number = int(version[2]), int(version[3])
            return number < FIRST_NEW[version[1].lower()]
    return any(1 <= severity <= MEDIUM and GREETINGS.search(text) for severity, text in texts)
