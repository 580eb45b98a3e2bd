"""What a report takes of PX4's topics besides the field map: flags, commands, the local track."""

import numpy as np

from analysis.field_maps.autopilot_names import NAMES
from analysis.recordings.flight_logs.autopilot_log import AutopilotLog
from analysis.report.curves.recording import Event, FlightData, GroundTrack, Message, local_track
from analysis.report.curves.vehicle_phase import CLASSES, PX4_TYPES, VTOL
from analysis.report.recordings.mapped_message import add_flag
from mavproxy_fault.numerics.constants import MEAN_EARTH_RADIUS_M

LOCAL = "local estimate"
LOCAL_FIELDS = {"x", "y", "z", "ref_lat", "ref_lon", "ref_alt"}
STATES = {"vehicle_status": "mode", "estimator_selector_status": "estimator in use"}


def px4_class(log: AutopilotLog) -> str:
    """Class of the vehicle, by its status."""
    status = log.topics.get(("vehicle_status", 0), {})
    if "is_vtol" in status and status["is_vtol"].any():
        return VTOL
    if "vehicle_type" in status:
        return PX4_TYPES.get(int(status["vehicle_type"][-1]), "")
    return CLASSES.get(int(status["system_type"][-1]), "") if "system_type" in status else ""


def add_px4_parts(found: FlightData) -> int:
    """Add them; returns UTC at zero on the axis in us, 0 if unknown."""
    for name, message in found.messages.items():
        if name.startswith("estimator_status_flags"):
            number = name.removeprefix("estimator_status_flags").replace("_", " ")
            # Faults and rejected measurements.
            for field in message.columns:
                if field.startswith(("fs_", "reject_")):
                    text, raised = field.replace("_", " "), message.columns[field] > 0
                    add_flag(found, "flag", text, message, raised, number)
    position = found.messages.get("vehicle_local_position")
    if position is not None and position.columns.keys() >= LOCAL_FIELDS:
        found.tracks.extend(_local_track(position))
    status = found.messages.get("vehicle_status")
    if status is not None and {"nav_state_user_intention", "failsafe"} <= status.columns.keys():
        found.events.extend(_commanded_modes(status))
    lanes = {span.lane for span in found.spans}
    lacking = [name for name in STATES.keys() & found.messages if STATES[name] not in lanes]
    if lacking:
        found.notes.append(f"fields missing in {', '.join(lacking)}: no spans from it")
    return _utc0_us(found)


def _utc0_us(found: FlightData) -> int:
    """By the last fix with a time, as receivers correct their clock after the first fixes."""
    fixes = found.messages.get("vehicle_gps_position")
    if fixes is None or not (utc_us := fixes.columns.get("time_utc_usec", np.zeros(1))).any():
        return 0
    last = int(np.flatnonzero(utc_us)[-1])
    return int(utc_us[last]) - int(fixes.columns["timestamp"][last]) + found.t0_us


def _local_track(message: Message) -> list[GroundTrack]:
    """The local position around its reference point, on a sphere; without one a local track."""
    topic, t_s = message.columns, message.t_s
    lat0, lon0 = topic["ref_lat"].astype(float), topic["ref_lon"].astype(float)
    known = np.isfinite(topic["x"])
    keep = np.isfinite(lat0) & (lat0 != 0) & known
    if keep.sum() < 2:
        north, east, down = (topic[key][known].astype(float) for key in "xyz")
        return [local_track(LOCAL, t_s[known], north, east, down)] if known.sum() > 1 else []
    lat = lat0 + np.degrees(topic["x"] / MEAN_EARTH_RADIUS_M)
    # A degree of longitude is shorter by cos(latitude).
    lon = lon0 + np.degrees(topic["y"] / MEAN_EARTH_RADIUS_M) / np.cos(np.radians(lat0))
    alt = topic["ref_alt"] - topic["z"]
    return [GroundTrack(LOCAL, t_s[keep], lat[keep], lon[keep], alt[keep].astype(float))]


def _commanded_modes(status: Message) -> list[Event]:
    """The modes that a user chose, and where PX4 leaves them by a failsafe (PX4 1.14 and later)."""
    t_s, topic = status.t_s, status.columns
    chosen, failsafe = topic["nav_state_user_intention"], topic["failsafe"].astype(bool)
    began = np.flatnonzero(np.diff(chosen.astype(int), prepend=-1)).tolist()
    names = NAMES["PX4 navigation state"]
    found = [
        Event(float(t_s[i]), "command", names.get(int(chosen[i]), f"mode {chosen[i]}"))
        for i in began
    ]
    rises = np.flatnonzero(np.diff(failsafe, prepend=False) & failsafe)
    return found + [Event(float(t_s[i]), "failsafe", "failsafe of PX4", 4) for i in rises.tolist()]
