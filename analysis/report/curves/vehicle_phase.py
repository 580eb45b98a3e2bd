"""The kind of vehicle that a log is of, and the phases of its flight: armed, and in the air.

The class of a vehicle decides which checks make sense, and what the numbers of ArduPilot's flight
modes mean: each firmware counts its own. PX4: `px4_custom_mode.h`.
"""

import itertools
import re
from collections.abc import Mapping, Sequence

import numpy as np

from analysis.field_maps.autopilot_names import NAMES
from analysis.report.curves.recording import FlightData, Signal, merged_windows
from mavproxy_fault.schedule.triggers import PX4_AUTO, PX4_MAIN

Windows = list[tuple[float, float]]

COPTER, PLANE, VTOL, ROVER, SUB, HELI, BLIMP, TRACKER = (
    "copter", "plane", "VTOL", "rover", "sub", "helicopter", "blimp", "tracker",
)  # fmt: skip
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
CLASSES, BUILDS, PX4_TYPES = NAMES["class"], NAMES["ArduPilot build"], NAMES["PX4 type"]
ARDUPILOT, PX4 = 3, 12

MODES: Mapping[str, Mapping[int, str]] = {
    **{kind: NAMES[kind] for kind in (COPTER, PLANE, ROVER, SUB, TRACKER, BLIMP)},
    HELI: NAMES[COPTER], VTOL: NAMES[PLANE],
}  # fmt: skip
FLYERS = {COPTER, HELI, PLANE, VTOL, BLIMP}
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
    return MODES.get(vehicle, MODES[COPTER]).get(custom_mode, f"mode {custom_mode}")


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
        height = recording.curve("height", "estimate", "controller")
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
    height = recording.curve("height", "estimate", "controller")
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


def _above(height: Signal, start_s: float, end_s: float) -> Windows:
    """From the first to the last time off the ground while armed."""
    inside = (height.t_s >= start_s) & (height.t_s <= end_s) & np.isfinite(height.value)
    t_s, metres = height.t_s[inside], height.value[inside]
    # Also below the start: a flight may begin on a hill.
    up = np.flatnonzero(np.abs(metres - metres[:1]) > OFF_GROUND_M)
    return [(float(t_s[up[0]]), float(t_s[up[-1]]))] if len(up) else []
