"""A PX4 ULog to a `Recording`; topics and fields as PX4's message definitions name them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.ulog import Topic, ULogFile
from analysis.report.recordings.curves import euler_deg
from analysis.report.recordings.recording import Event, Recording, Signal, Span, Track, runs

Values = NDArray[np.float64]
NAV_STATES = {
    0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "MISSION", 4: "LOITER", 5: "RTL", 6: "POSITION SLOW",
    10: "ACRO", 12: "DESCEND", 13: "TERMINATION", 14: "OFFBOARD", 15: "STABILIZED", 17: "TAKEOFF",
    18: "LAND", 19: "FOLLOW", 20: "PRECLAND", 21: "ORBIT", 22: "VTOL TAKEOFF",
}  # fmt: skip
ARMED = 2
UNLIKELY_FLAGS = ("fs_", "reject_")  # of estimator_status_flags: faults and refused measurements
FAILSAFES = (
    "attitude_invalid", "local_position_invalid", "global_position_invalid", "gcs_connection_lost",
    "manual_control_signal_lost", "battery_unhealthy", "geofence_breached", "mission_failure",
    "wind_limit_exceeded", "fd_critical_failure", "fd_imbalanced_prop", "fd_motor_failure",
    "local_position_accuracy_low",
)  # fmt: skip
SPOOFING = {2: "jamming/spoofing indicated", 3: "multiple indications"}


def _field(name: str, scale: float = 1.0) -> Callable[[Topic], Values]:
    return lambda topic: topic[name].astype(float) * scale


def _norm(*names: str) -> Callable[[Topic], Values]:
    def values(topic: Topic) -> Values:
        return np.asarray(np.sqrt(sum(topic[name].astype(float) ** 2 for name in names)))

    return values


def _largest(*names: str) -> Callable[[Topic], Values]:
    def values(topic: Topic) -> Values:
        return np.asarray(np.max([np.abs(topic[name].astype(float)) for name in names], axis=0))

    return values


def _euler(part: int, prefix: str = "q") -> Callable[[Topic], Values]:
    def values(topic: Topic) -> Values:
        q = np.stack([topic[f"{prefix}[{i}]"].astype(float) for i in range(4)])
        return euler_deg(q)[part]

    return values


def _positive(name: str) -> Callable[[Topic], Values]:
    """A value of which 0 or less means that it is unknown."""
    return lambda topic: np.where(topic[name] > 0, topic[name].astype(float), np.nan)


def _dilution(name: str) -> Callable[[Topic], Values]:
    """A dilution of precision; 99.99 and more say that there is no fix."""
    return lambda topic: np.where(topic[name] < 99, topic[name].astype(float), np.nan)


CURVES: tuple[tuple[str, str, str, Callable[[Topic], Values]], ...] = (
    ("vehicle_attitude", "roll", "ATTITUDE", _euler(0)),
    ("vehicle_attitude", "pitch", "ATTITUDE", _euler(1)),
    ("vehicle_attitude", "yaw", "ATTITUDE", _euler(2)),
    ("vehicle_attitude_setpoint", "roll", "desired", _euler(0, "q_d")),
    ("vehicle_attitude_setpoint", "pitch", "desired", _euler(1, "q_d")),
    ("vehicle_attitude_groundtruth", "roll", "truth", _euler(0)),
    ("vehicle_attitude_groundtruth", "pitch", "truth", _euler(1)),
    ("vehicle_attitude_groundtruth", "yaw", "truth", _euler(2)),
    ("vehicle_global_position", "altitude", "estimate", _field("altitude_msl_m")),
    ("vehicle_gps_position", "altitude", "GPS", _field("altitude_msl_m")),
    ("vehicle_local_position", "height", "estimate", _field("z", -1.0)),
    ("vehicle_local_position", "speed", "ground", _norm("vx", "vy")),
    ("vehicle_gps_position", "speed", "GPS", _field("vel_m_s")),
    ("airspeed_validated", "speed", "air", _field("calibrated_airspeed_m_s")),
    ("vehicle_local_position", "climb", "estimate", _field("vz", -1.0)),
    ("estimator_status", "ratio", "velocity", _field("vel_test_ratio")),
    ("estimator_status", "ratio", "horizontal position", _field("pos_test_ratio")),
    ("estimator_status", "ratio", "vertical position", _field("hgt_test_ratio")),
    ("estimator_status", "ratio", "magnetometer", _field("mag_test_ratio")),
    ("estimator_status", "ratio", "heading", _field("hdg_test_ratio")),
    ("estimator_status", "ratio", "airspeed", _field("tas_test_ratio")),
    ("estimator_innovations", "innovation", "GPS position north, m", _field("gps_hpos[0]")),
    ("estimator_innovations", "innovation", "GPS position east, m", _field("gps_hpos[1]")),
    ("estimator_innovations", "innovation", "GPS velocity north, m/s", _field("gps_hvel[0]")),
    ("estimator_innovations", "innovation", "GPS velocity east, m/s", _field("gps_hvel[1]")),
    ("estimator_innovations", "innovation", "baro height, m", _field("baro_vpos")),
    ("estimator_innovations", "innovation", "heading, rad", _field("heading")),
    ("estimator_status", "accuracy", "horizontal", _field("pos_horiz_accuracy")),
    ("estimator_status", "accuracy", "vertical", _field("pos_vert_accuracy")),
    ("vehicle_gps_position", "gps-satellites", "GPS", _field("satellites_used")),
    ("vehicle_gps_position", "gps-fix", "GPS", _field("fix_type")),
    ("vehicle_gps_position", "gps-accuracy", "horizontal", _field("eph")),
    ("vehicle_gps_position", "gps-accuracy", "vertical", _field("epv")),
    ("vehicle_gps_position", "gps-dilution", "hdop", _dilution("hdop")),
    ("vehicle_gps_position", "gps-dilution", "vdop", _dilution("vdop")),
    ("vehicle_gps_position", "gps-noise", "jamming indicator", _field("jamming_indicator")),
    ("vehicle_gps_position", "gps-noise", "noise per ms", _field("noise_per_ms")),
    ("vehicle_gps_position", "gps-noise", "spoofing state", _field("spoofing_state")),
    ("sensor_combined", "accel", "x", _field("accelerometer_m_s2[0]")),
    ("sensor_combined", "accel", "y", _field("accelerometer_m_s2[1]")),
    ("sensor_combined", "accel", "z", _field("accelerometer_m_s2[2]")),
    ("sensor_combined", "gyro", "x", _field("gyro_rad[0]")),
    ("sensor_combined", "gyro", "y", _field("gyro_rad[1]")),
    ("sensor_combined", "gyro", "z", _field("gyro_rad[2]")),
    ("sensor_mag", "mag", "compass", _norm("x", "y", "z")),
    ("vehicle_air_data", "baro", "barometer", _field("baro_pressure_pa", 0.01)),
    ("vehicle_imu_status", "vibration", "accelerometer", _field("accel_vibration_metric")),
    (
        "vehicle_imu_status",
        "clipping",
        "accelerometer",
        _largest("accel_clipping[0]", "accel_clipping[1]", "accel_clipping[2]"),
    ),
    ("battery_status", "battery-voltage", "battery", _field("voltage_v")),
    ("battery_status", "battery-current", "battery", _field("current_a")),
    ("battery_status", "battery-remaining", "battery", _field("remaining", 100)),
    ("system_power", "board-voltage", "5 V rail", _positive("voltage5v_v")),
    ("cpuload", "load", "processor", _field("load", 100)),
    ("actuator_motors", "actuators", "motor 1", _field("control[0]")),
    ("actuator_motors", "actuators", "motor 2", _field("control[1]")),
    ("actuator_motors", "actuators", "motor 3", _field("control[2]")),
    ("actuator_motors", "actuators", "motor 4", _field("control[3]")),
)


def recording_of_ulog(log: ULogFile, name: str, t0_us: int | None = None) -> Recording:
    """Everything of a ULog that a report shows; the axis starts at `t0_us` or the log's start."""
    start_us = log.start_us if t0_us is None else t0_us
    found = Recording(name)
    log_lacks: list[str] = []
    for (topic_name, instance), topic in sorted(log.topics.items()):
        t_s: Values = (topic["timestamp"].astype(np.float64) - start_us) * 1e-6
        suffix = f" {instance + 1}" if instance else ""
        for topic_of_curve, panel, label, values in CURVES:
            if topic_of_curve == topic_name and (y := _values(topic, values)) is not None:
                found.signals.append(Signal(panel, label + suffix, t_s, y))
        try:
            found.tracks.extend(_tracks(topic_name, suffix, topic, t_s))
            found.spans.extend(_spans(topic_name, suffix, topic, t_s))
        except KeyError:  # a definition that is damaged, or of another version of PX4
            log_lacks.append(topic_name)
    for t_us, severity, text in log.messages:
        found.events.append(Event((t_us - start_us) * 1e-6, "text", text.strip(), severity))
    found.events.extend(_mode_events(found.spans))
    found.events.sort(key=lambda event: event.t_s)
    for parameter, value in log.parameters.items():
        found.parameters[parameter] = [(0.0, value)]
    for t_us, parameter, value in log.changes:
        found.parameters.setdefault(parameter, []).append(((t_us - start_us) * 1e-6, value))
    return Recording(
        name, "px4", start_us, max((float(s.t_s[-1]) for s in found.signals), default=0.0),
        found.signals, found.spans, found.events, found.tracks, [], found.parameters,
        _notes(log, log_lacks),
    )  # fmt: skip


def _values(topic: Topic, values: Callable[[Topic], Values]) -> Values | None:
    """The curve, or None where this version of PX4 lacks a field of it, or has no value in it."""
    try:
        found = values(topic)
    except KeyError:
        return None
    return found if np.isfinite(found).any() else None


def _tracks(name: str, suffix: str, topic: Topic, t_s: Values) -> list[Track]:
    labels = {
        "vehicle_gps_position": "GPS",
        "vehicle_global_position": "estimate",
        "vehicle_global_position_groundtruth": "truth",
    }
    if name == "vehicle_local_position" and "ref_lat" in topic:
        return _local_track(topic, t_s)
    if name not in labels or "latitude_deg" not in topic:
        return []
    keep = np.isfinite(topic["latitude_deg"]) & (topic["latitude_deg"] != 0)
    if keep.sum() < 2:
        return []
    columns = [topic[key][keep] for key in ("latitude_deg", "longitude_deg", "altitude_msl_m")]
    return [Track(labels[name] + suffix, t_s[keep], *(column.astype(float) for column in columns))]


def _local_track(topic: Topic, t_s: Values) -> list[Track]:
    """The local estimate around its reference point, on a sphere."""
    lat0, lon0 = topic["ref_lat"].astype(float), topic["ref_lon"].astype(float)
    keep = np.isfinite(lat0) & (lat0 != 0) & np.isfinite(topic["x"])
    if keep.sum() < 2:
        return []
    lat = lat0 + np.degrees(topic["x"] / 6_371_000.0)
    lon = lon0 + np.degrees(topic["y"] / 6_371_000.0) / np.cos(np.radians(lat0))
    alt = topic["ref_alt"] - topic["z"]
    return [Track("local estimate", t_s[keep], lat[keep], lon[keep], alt[keep].astype(float))]


def _spans(name: str, suffix: str, topic: Topic, t_s: Values) -> list[Span]:
    if name == "vehicle_status":
        states = topic["nav_state"].tolist()
        armed = (topic["arming_state"] == ARMED).tolist()
        texts = [NAV_STATES.get(state, f"state {state}") for state in states]
        words = ["armed" if now else "disarmed" for now in armed]
        return _stretches("mode", t_s, texts) + _stretches("armed", t_s, words)
    if name == "failsafe_flags":
        return _flag_spans("failsafe", FAILSAFES, topic, t_s)
    if name == "estimator_status_flags":
        flags = [key for key in topic if key.startswith(UNLIKELY_FLAGS)]
        return _flag_spans(f"estimator{suffix}", flags, topic, t_s)
    return []


def _flag_spans(lane: str, flags: Sequence[str], topic: Topic, t_s: Values) -> list[Span]:
    spans = []
    for flag in flags:
        raised: NDArray[Any] | None = topic.get(flag)
        if raised is None or raised.all():
            continue  # a flag that is always up tells of the set-up, not of the flight
        for begin, end in runs(raised.astype(bool)):
            stop = float(t_s[min(end, len(t_s) - 1)])
            text = flag.replace("_", " ")
            spans.append(Span(f"{lane}: {text}", float(t_s[begin]), stop, text, "flag"))
    return spans


def _stretches(lane: str, t_s: Values, texts: Sequence[str]) -> list[Span]:
    spans = []
    begin = 0
    for i in range(1, len(texts) + 1):
        if i == len(texts) or texts[i] != texts[begin]:
            end = float(t_s[min(i, len(texts) - 1)])
            spans.append(Span(lane, float(t_s[begin]), end, texts[begin], "mode"))
            begin = i
    return spans


def _mode_events(spans: Sequence[Span]) -> list[Event]:
    found = [Event(s.start_s, "mode", s.text) for s in spans if s.kind == "mode" and s.start_s > 0]
    return found + [
        Event(s.start_s, "flag", f"{s.lane} raised", 4) for s in spans if s.kind == "flag"
    ]


def _notes(log: ULogFile, lacking: Sequence[str]) -> list[str]:
    version = str(log.info.get("ver_sw_branch", "")) or str(log.info.get("ver_sw", ""))[:10]
    notes = [f"PX4 {version} on {log.info.get('ver_hw', 'unknown hardware')}"]
    if log.dropouts:
        total = sum(duration for _, duration in log.dropouts)
        notes.append(f"{len(log.dropouts)} dropouts in the log, {total:.2f} s in all")
    if lacking:
        notes.append(f"fields missing in {', '.join(lacking)}: no spans or track from there")
    if log.cut:
        notes.append("the file ends in the middle of a message: it was cut short")
    if log.damaged:
        notes.append("parts of the file are damaged and were passed over")
    return notes
