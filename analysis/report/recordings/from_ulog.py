"""Convert a PX4 ULog to `FlightData`; topics and fields are named as in PX4's definitions."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.ulog_map import GATES, ULOG
from analysis.recordings.flight_logs.ulog import Topic, ULogFile
from analysis.report.curves.recording import (
    Event,
    FlightData,
    GroundTrack,
    Message,
    Span,
    active_spans,
    flag_events,
    local_track,
    value_spans,
)
from analysis.report.curves.vehicle_phase import CLASSES, PX4_TYPES, VTOL
from analysis.report.recordings.mapped_message import add_flag, add_message
from analysis.report.recordings.vehicle_identity import identity_by_info
from mavproxy_fault.numerics.constants import MEAN_EARTH_RADIUS_M

Values = NDArray[np.float64]
NAV_STATES = {
    0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "MISSION", 4: "LOITER", 5: "RTL", 6: "POSITION SLOW",
    10: "ACRO", 12: "DESCEND", 13: "TERMINATION", 14: "OFFBOARD", 15: "STABILIZED", 17: "TAKEOFF",
    18: "LAND", 19: "FOLLOW", 20: "PRECLAND", 21: "ORBIT", 22: "VTOL TAKEOFF",
}  # fmt: skip
ARMED = 2
JAMMING = {2: "warning", 3: "critical"}  # jamming_state of sensor_gps
SPOOFING = {2: "indicated", 3: "multiple indications"}
LOCAL = "local estimate"
SATURATED = 0.99  # share of a motor's range taken as saturated


def recording_of_ulog(log: ULogFile, name: str, t0_us: int | None = None) -> FlightData:
    """Convert a ULog; the time axis starts at `t0_us` or the log's start."""
    start_us = log.start_us if t0_us is None else t0_us
    found = FlightData(name, "px4")
    # Older versions have no field `connected`.
    constants = GATES | log.parameters | {"connected": 1.0}
    log_lacks: list[str] = []
    for (topic_name, instance), topic in sorted(log.topics.items()):
        t_s: Values = (topic["timestamp"].astype(np.float64) - start_us) * 1e-6
        suffix = f" {instance + 1}" if instance else ""
        message = found.messages[f"{topic_name}{suffix.replace(' ', '_')}"] = Message(t_s, topic)
        lines = [line for line in ULOG.get(topic_name, ()) if not (line.first and instance)]
        add_message(found, lines, message, suffix, constants)
        for field in topic if topic_name == "estimator_status_flags" else ():
            # Faults and rejected measurements.
            if field.startswith(("fs_", "reject_")):
                add_flag(found, "flag", field.replace("_", " "), message, topic[field] > 0, suffix)
        try:
            if topic_name == "vehicle_local_position" and "ref_lat" in topic:
                found.tracks.extend(_local_track(topic, t_s))
            found.events.extend(_commanded_modes(topic_name, topic, t_s))
            spans = _spans(topic_name, suffix, topic, t_s)
            found.spans.extend(spans)
            found.events.extend(flag_events(spans, float(t_s[-1])))
        except KeyError:  # a corrupted definition, or another version of PX4
            log_lacks.append(topic_name)
    found.spans.extend(
        Span(
            "log dropout", at_s := (t_us - start_us) * 1e-6, at_s + for_s, f"{for_s:.2f} s", "warn"
        )
        # In a separate lane: dropouts explain gaps in the curves.
        for t_us, for_s in log.dropouts
    )
    for t_us, severity, text in log.messages:
        found.events.append(Event((t_us - start_us) * 1e-6, "text", text, severity))
    found.events.extend(_mode_events(found.spans))
    found.events.sort(key=lambda event: event.t_s)
    initial = [(start_us, name, value) for name, value in log.parameters.items()]
    for t_us, parameter, value in [*initial, *log.changes]:
        found.add_parameter(parameter, (t_us - start_us) * 1e-6, value)
    return FlightData(
        name, "px4", start_us, max((float(s.t_s[-1]) for s in found.signals), default=0.0),
        found.signals, found.spans, found.events, found.tracks, [], found.parameters,
        _notes(log, log_lacks), utc0_us=_utc0_us(log.topics, start_us), messages=found.messages,
        defaults=log.defaults, printed=log.printed, vehicle=_vehicle_class(log),
        identity=identity_by_info(log.info, log.parameters),
    )  # fmt: skip


def _vehicle_class(log: ULogFile) -> str:
    status = log.topics.get(("vehicle_status", 0), {})
    if "is_vtol" in status and status["is_vtol"].any():
        return VTOL
    if "vehicle_type" in status:
        return PX4_TYPES.get(int(status["vehicle_type"][-1]), "")
    return CLASSES.get(int(status["system_type"][-1]), "") if "system_type" in status else ""


def _utc0_us(topics: Mapping[tuple[str, int], Topic], start_us: int) -> int:
    """UTC at `start_us` in us, from the last fix with a time; 0 if there is none."""
    topic = topics.get(("vehicle_gps_position", 0), {})
    if "time_utc_usec" not in topic or not topic["time_utc_usec"].any():
        return 0
    # The last one, as receivers correct their clock after the first fixes.
    last = int(np.flatnonzero(topic["time_utc_usec"])[-1])
    return int(topic["time_utc_usec"][last]) - int(topic["timestamp"][last]) + start_us


def _local_track(topic: Topic, t_s: Values) -> list[GroundTrack]:
    """The local position around its reference point, on a sphere; without one a local track."""
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


def _spans(name: str, suffix: str, topic: Topic, t_s: Values) -> list[Span]:
    if name == "vehicle_status":
        states = topic["nav_state"].tolist()
        armed = (topic["arming_state"] == ARMED).tolist()
        texts = [NAV_STATES.get(state, f"state {state}") for state in states]
        names = ["armed" if now else "disarmed" for now in armed]
        return value_spans("mode", t_s, texts) + value_spans("armed", t_s, names)
    if name == "vehicle_land_detected" and "landed" in topic:
        landed = topic["landed"].astype(bool).tolist()
        return value_spans("flying", t_s, ["landed" if low else "flying" for low in landed])
    if name == "estimator_selector_status":
        texts = [f"instance {i + 1}" for i in topic["primary_instance"].tolist()]
        return value_spans("estimator in use", t_s, texts)
    if name == "vehicle_gps_position":
        return _state_spans(f"GPS jamming{suffix}", "jamming_state", JAMMING, topic, t_s) + (
            _state_spans(f"GPS spoofing{suffix}", "spoofing_state", SPOOFING, topic, t_s)
        )
    if name == "actuator_motors":
        return _saturated(topic, t_s)
    return []


def _state_spans(
    lane: str, field: str, texts: Mapping[int, str], topic: Topic, t_s: Values
) -> list[Span]:
    """Spans in which a state had one of the alarming values of `texts`."""
    states = topic.get(field)
    if states is None:
        return []
    words = [texts.get(state, "") for state in states.tolist()]
    return value_spans(lane, t_s, words, "flag")


def _saturated(topic: Topic, t_s: Values) -> list[Span]:
    """Spans in which each motor was saturated."""
    found: list[Span] = []
    for number in range(1, 13):
        raw = topic.get(f"control[{number - 1}]")
        if raw is not None:
            found += active_spans(
                "motor at its limit", t_s, raw >= SATURATED, f"motor {number}", "warn"
            )
    return found


def _commanded_modes(name: str, topic: Topic, t_s: Values) -> list[Event]:
    """The modes that a user chose, and where PX4 leaves them by a failsafe (PX4 1.14 and later)."""
    if name != "vehicle_status" or "nav_state_user_intention" not in topic:
        return []
    chosen, failsafe = topic["nav_state_user_intention"], topic["failsafe"].astype(bool)
    began = np.flatnonzero(np.diff(chosen.astype(int), prepend=-1)).tolist()
    found = [
        Event(float(t_s[i]), "command", NAV_STATES.get(int(chosen[i]), f"state {chosen[i]}"))
        for i in began
    ]
    rises = np.flatnonzero(failsafe[1:] & ~failsafe[:-1]) + 1
    return found + [Event(float(t_s[i]), "failsafe", "failsafe of PX4", 4) for i in rises.tolist()]


def _mode_events(spans: Sequence[Span]) -> list[Event]:
    lanes: set[str] = set()
    found = []
    for span in spans:
        if span.kind == "mode" and span.lane in lanes:  # the first one is the initial mode
            found.append(Event(span.start_s, "mode", span.text))
        lanes.add(span.lane)
    return found


def _notes(log: ULogFile, lacking: Sequence[str]) -> list[str]:
    notes = []
    if log.dropouts:
        total = sum(duration for _, duration in log.dropouts)
        notes.append(f"{len(log.dropouts)} dropouts in the log, {total:.2f} s in all")
    notes.extend(log.times.notes())
    if lacking:
        notes.append(f"fields missing in {', '.join(lacking)}: no spans or tracks from it")
    if log.cut:
        notes.append("the file ends within a message: the log is truncated")
    if log.corrupted:
        notes.append("parts of the file are corrupted and were skipped")
    return notes
