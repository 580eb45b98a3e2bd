"""The kind of vehicle that a log is of, and the phases of its flight: armed, and in the air.

The class of a vehicle decides which checks make sense, and what the numbers of ArduPilot's flight
modes mean: each firmware counts its own (`mode` enumerations in mode.h; MAVLink's
COPTER_MODE, PLANE_MODE, ROVER_MODE, SUB_MODE, TRACKER_MODE). PX4: `px4_custom_mode.h`.
"""

import itertools
import re
from collections.abc import Mapping, Sequence

import numpy as np

from analysis.report.curves.recording import FlightData, Signal, merged_windows
from mavproxy_fault.schedule.triggers import PX4_AUTO, PX4_MAIN

Windows = list[tuple[float, float]]

COPTER, PLANE, VTOL, ROVER, SUB, HELI, BLIMP, TRACKER = (
    "copter", "plane", "VTOL", "rover", "sub", "helicopter", "blimp", "tracker",
)  # fmt: skip
# Classes by MAV_TYPE.
CLASSES: Mapping[int, str] = {
    1: PLANE, 2: COPTER, 3: COPTER, 4: HELI, 5: TRACKER, 7: BLIMP, 10: ROVER, 11: ROVER, 12: SUB,
    13: COPTER, 14: COPTER, 15: COPTER, **dict.fromkeys(range(19, 26), VTOL), 29: COPTER,
    35: COPTER,
}  # fmt: skip
# Classes by the firmware's name in its messages, and by ArduPilot's APM_BUILD_TYPE (VER.BU).
FIRMWARES = (
    (re.compile(r"copter-heli|traditionalheli|heli\b", re.IGNORECASE), HELI),
    (re.compile(r"copter", re.IGNORECASE), COPTER),
    (re.compile(r"ardu ?sub|\bsub v", re.IGNORECASE), SUB),
    (re.compile(r"rover", re.IGNORECASE), ROVER),
    (re.compile(r"antenna ?tracker", re.IGNORECASE), TRACKER),
    (re.compile(r"blimp", re.IGNORECASE), BLIMP),
    (re.compile(r"plane", re.IGNORECASE), PLANE),
)
BUILDS = {1: ROVER, 2: COPTER, 3: PLANE, 4: TRACKER, 7: SUB, 12: BLIMP, 13: HELI}
PX4_TYPES = {1: COPTER, 2: PLANE, 3: ROVER, 4: BLIMP}  # vehicle_status.vehicle_type
ARDUPILOT, PX4 = 3, 12

COPTER_MODES = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL",
    7: "CIRCLE", 8: "POSITION", 9: "LAND", 10: "OF_LOITER", 11: "DRIFT", 13: "SPORT", 14: "FLIP",
    15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB", 20: "GUIDED_NOGPS",
    21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE",
    27: "AUTO_RTL", 28: "TURTLE", 29: "RATE_ACRO",
}  # fmt: skip
PLANE_MODES = {
    0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB",
    7: "CRUISE", 8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 13: "TAKEOFF",
    14: "AVOID_ADSB", 15: "GUIDED", 16: "INITIALISING", 17: "QSTABILIZE", 18: "QHOVER",
    19: "QLOITER", 20: "QLAND", 21: "QRTL", 22: "QAUTOTUNE", 23: "QACRO", 24: "THERMAL",
    25: "LOITERALTQLAND", 26: "AUTOLAND",
}  # fmt: skip
ROVER_MODES = {
    0: "MANUAL", 1: "ACRO", 2: "LEARNING", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW",
    7: "SIMPLE", 8: "DOCK", 9: "CIRCLE", 10: "AUTO", 11: "RTL", 12: "SMART_RTL", 15: "GUIDED",
    16: "INITIALISING",
}  # fmt: skip
SUB_MODES = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 7: "CIRCLE", 9: "SURFACE",
    16: "POSHOLD", 19: "MANUAL", 20: "MOTOR_DETECT", 21: "SURFTRAK",
}  # fmt: skip
TRACKER_MODES = {0: "MANUAL", 1: "STOP", 2: "SCAN", 4: "GUIDED", 10: "AUTO", 16: "INITIALISING"}
BLIMP_MODES = {
    0: "LAND", 1: "MANUAL", 2: "VELOCITY", 3: "LOITER", 4: "RTL", 5: "AUTO", 6: "HOLD",
}  # fmt: skip
MODES: Mapping[str, Mapping[int, str]] = {
    COPTER: COPTER_MODES, HELI: COPTER_MODES, PLANE: PLANE_MODES, VTOL: PLANE_MODES,
    ROVER: ROVER_MODES, SUB: SUB_MODES, TRACKER: TRACKER_MODES, BLIMP: BLIMP_MODES,
}  # fmt: skip
ROTORS, FLYERS = {COPTER, HELI}, {COPTER, HELI, PLANE, VTOL, BLIMP}
ARMED, FLYING = "armed", "flying"

STILL_M, STILL_S = 0.3, 3.0  # chosen: less moves only a vehicle that lies still
LIFTED_M = 0.5  # chosen: the noise of a height on the ground, however long it is armed
OFF_GROUND_M = 1.0  # chosen: above the noise of a barometric height at rest


def mode_name(autopilot: int, vehicle: str, custom_mode: int) -> str:
    """Name of a HEARTBEAT's custom mode for a class of vehicle, as ground stations show it."""
    if autopilot == PX4:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        # Main mode 4 is AUTO.
        if main == 4 and sub in PX4_AUTO:
            return PX4_AUTO[sub]
        return PX4_MAIN.get(main, f"mode {custom_mode}")
    # Other autopilots define their own numbers.
    if autopilot != ARDUPILOT:
        return f"mode {custom_mode}"
    return MODES.get(vehicle, COPTER_MODES).get(custom_mode, f"mode {custom_mode}")


def class_by_texts(texts: Sequence[str], parameters: Mapping[str, float]) -> str:
    """Class of a vehicle by the name of its firmware in its first messages; "" if unknown."""
    found = next((kind for word, kind in FIRMWARES if any(map(word.search, texts))), "")
    return VTOL if found == PLANE and parameters.get("Q_ENABLE", 0.0) > 0.0 else found


def armed_windows(recording: FlightData) -> Windows | None:
    """Windows in which the vehicle was armed; None if the log has no arming state."""
    return _windows(recording, ARMED)


def flying_windows(recording: FlightData) -> Windows | None:
    """Windows in which the vehicle was armed and in the air; None if the log does not show it.

    By the autopilot's own landed state, else by the height above where it was armed.
    """
    armed = armed_windows(recording)
    if not armed:
        return armed
    air = _windows(recording, FLYING)
    if air is None:
        height = _height(recording)
        if height is None:
            return armed
        air = [window for start, end in armed for window in _above(height, start, end)]
    flown = [(start, _until_rest(recording, start, end)) for start, end in _common(armed, air)]
    return [(start, end) for start, end in flown if end > start]


def _common(first: Windows, second: Windows) -> Windows:
    """What two sorted lists of windows have in common; a log may hold thousands of flights."""
    found, at = [], 0
    for start, end in first:
        while at < len(second) and second[at][1] <= start:
            at += 1
        for other_start, other_end in itertools.islice(second, at, None):
            if other_start >= end:
                break
            found.append((max(start, other_start), min(end, other_end)))
    return found


def _until_rest(recording: FlightData, start_s: float, end_s: float) -> float:
    """The end of a window in the air, or before it the time from which the vehicle lies still at
    its lowest height: one that has tipped over is not found to have landed. The start of one in
    which it never left the ground."""
    height = _height(recording)
    if height is None:
        return end_s
    inside = (height.t_s >= start_s) & (height.t_s <= end_s) & np.isfinite(height.value)
    t_s, metres = height.t_s[inside], height.value[inside]
    if not len(t_s) or metres[-1] > metres.min() + STILL_M:
        return end_s
    if np.ptp(metres) < LIFTED_M:
        return start_s
    moving = np.flatnonzero(np.abs(metres - metres[-1]) > STILL_M)
    rest_s = float(t_s[moving[-1]]) if len(moving) else end_s
    return rest_s if end_s - rest_s > STILL_S else end_s


def _windows(recording: FlightData, state: str) -> Windows | None:
    spans = [span for span in recording.spans if span.lane.startswith(state)]
    if not spans:
        # Unknown, which differs from "never" (an empty list).
        return None
    return merged_windows([(s.start_s, s.end_s) for s in spans if s.text == state])


def _height(recording: FlightData) -> Signal | None:
    named = {signal.name: signal for signal in recording.of("height")}
    return named.get("estimate") or named.get("controller")


def _above(height: Signal, start_s: float, end_s: float) -> Windows:
    """From the first to the last time off the ground while armed."""
    inside = (height.t_s >= start_s) & (height.t_s <= end_s) & np.isfinite(height.value)
    t_s, metres = height.t_s[inside], height.value[inside]
    # Also below the start: a flight may begin on a hill.
    up = np.flatnonzero(np.abs(metres - metres[:1]) > OFF_GROUND_M)
    return [(float(t_s[up[0]]), float(t_s[up[-1]]))] if len(up) else []
