"""What PX4's estimators and failsafes say is wrong, as stretches; named as in its messages."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.ulog import Topic
from analysis.report.recordings.mode_names import ESTIMATOR_FLAGS
from analysis.report.recordings.recording import REFUSED_S, Span, active_spans

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]

UNLIKELY_FLAGS = ("fs_", "reject_")  # of estimator_status_flags: faults and refused measurements
GPS_CHECKS = "gps_check_fail_flags"
# Bits of estimator_status, as PX4's message definition numbers them; the last field was dropped
# when estimator_status_flags came.
ESTIMATOR_BITS = {
    "solution_status_flags": ESTIMATOR_FLAGS,
    GPS_CHECKS: {
        0: "GPS fix refused", 1: "GPS satellites refused", 2: "GPS dilution refused",
        3: "GPS horizontal accuracy refused", 4: "GPS vertical accuracy refused",
        5: "GPS speed accuracy refused", 6: "GPS horizontal drift refused",
        7: "GPS vertical drift refused", 8: "GPS horizontal speed refused",
        9: "GPS vertical speed refused",
    },
    "innovation_check_flags": {
        0: "velocity refused", 1: "horizontal position refused", 2: "vertical position refused",
        3: "compass x refused", 4: "compass y refused", 5: "compass z refused", 6: "yaw refused",
        7: "airspeed refused",
    },
}  # fmt: skip
# estimator_aid_src_NAME: what an estimator refuses. Gravity, drag and sideslip are no sensors.
AID_SOURCES = {
    "baro_hgt": "baro height", "gnss_hgt": "GNSS height", "gnss_pos": "GNSS position",
    "gnss_vel": "GNSS velocity", "gnss_yaw": "GNSS heading", "mag": "compass",
    "mag_heading": "compass heading", "airspeed": "airspeed", "rng_hgt": "distance sensor height",
    "ev_hgt": "vision height", "ev_pos": "vision position", "ev_vel": "vision velocity",
    "ev_yaw": "vision heading", "optical_flow": "optical flow",
}  # fmt: skip
AID_SOURCE = "estimator_aid_src_"
FAILSAFES = (
    "attitude_invalid", "local_position_invalid", "global_position_invalid", "gcs_connection_lost",
    "manual_control_signal_lost", "battery_unhealthy", "geofence_breached", "mission_failure",
    "wind_limit_exceeded", "fd_critical_failure", "fd_imbalanced_prop", "fd_motor_failure",
    "local_position_accuracy_low",
)  # fmt: skip


def flag_spans(name: str, suffix: str, topic: Topic, t_s: Values) -> list[Span]:
    """The stretches that a topic of a ULog tells, at the times `t_s` (n,); none for most topics."""
    if name == "failsafe_flags":
        return _flag_spans("failsafe", _flags(topic, FAILSAFES), t_s)
    if name == "estimator_status_flags":
        flags = _flags(topic, [key for key in topic if key.startswith(UNLIKELY_FLAGS)])
        return _flag_spans(f"estimator{suffix}", flags, t_s)
    if name == "estimator_status":
        # A receiver that is not good enough yet is no alarm: the estimator goes on with the rest.
        return [
            span
            for field, texts in ESTIMATOR_BITS.items()
            for span in _flag_spans(
                f"estimator{suffix}",
                _bits(topic, field, texts),
                t_s,
                kind="warn" if field == GPS_CHECKS else "flag",
            )
        ]
    source = AID_SOURCES.get(name.removeprefix(AID_SOURCE)) if AID_SOURCE in name else None
    if source is not None and "innovation_rejected" in topic:
        text, refused = f"{source} refused", topic["innovation_rejected"].astype(bool)
        return active_spans(f"estimator{suffix}: {text}", t_s, refused, text, "flag", REFUSED_S)
    return []


def _flags(topic: Topic, names: Sequence[str]) -> dict[str, Flags]:
    """Flags that are fields of their own, by their text."""
    return {n.replace("_", " "): topic[n].astype(bool) for n in names if n in topic}


def _bits(topic: Topic, field: str, texts: Mapping[int, str]) -> dict[str, Flags]:
    """Flags that are bits of a field, by their text."""
    if field not in topic:
        return {}
    return {text: topic[field].astype(np.int64) >> bit & 1 == 1 for bit, text in texts.items()}


def _flag_spans(
    lane: str, flags: Mapping[str, Flags], t_s: Values, kind: str = "flag"
) -> list[Span]:
    """Stretches in which flags were up; one that always is tells of the set-up, not the flight."""
    return [
        span
        for text, raised in flags.items()
        if not raised.all()
        for span in active_spans(f"{lane}: {text}", t_s, raised, text, kind)
    ]
