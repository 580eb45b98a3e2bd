"""Flags of PX4's estimators and failsafes as spans, named after the fields of its messages."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.ulog import Topic
from analysis.report.curves.recording import REJECTED_S, Span, active_spans
from analysis.report.recordings.event_names import ESTIMATOR_FLAGS

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]

UNLIKELY_FLAGS = ("fs_", "reject_")  # of estimator_status_flags: faults and rejected measurements
GPS_CHECKS = "gps_check_fail_flags"
# Bits of estimator_status, as PX4's message definition numbers them; the last field was dropped
# when estimator_status_flags came.
ESTIMATOR_BITS = {
    "solution_status_flags": ESTIMATOR_FLAGS,
    GPS_CHECKS: {
        0: "GPS fix rejected", 1: "GPS satellites rejected", 2: "GPS dilution rejected",
        3: "GPS horizontal accuracy rejected", 4: "GPS vertical accuracy rejected",
        5: "GPS speed accuracy rejected", 6: "GPS horizontal drift rejected",
        7: "GPS vertical drift rejected", 8: "GPS horizontal speed rejected",
        9: "GPS vertical speed rejected",
    },
    "innovation_check_flags": {
        0: "velocity rejected", 1: "horizontal position rejected", 2: "vertical position rejected",
        3: "compass x rejected", 4: "compass y rejected", 5: "compass z rejected",
        6: "yaw rejected", 7: "airspeed rejected",
    },
}  # fmt: skip
# estimator_aid_src_NAME: rejected measurements. Gravity, drag and sideslip are not sensors.
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
    """The flag spans of a ULog topic with times `t_s` (n,); none for most topics."""
    if name == "failsafe_flags":
        return _flag_spans("failsafe", _flags(topic, FAILSAFES), t_s)
    if name == "estimator_status_flags":
        flags = _flags(topic, [key for key in topic if key.startswith(UNLIKELY_FLAGS)])
        return _flag_spans(f"estimator{suffix}", flags, t_s)
    if name == "estimator_status":
        # A failed GPS quality check is a warning: the estimator continues without GPS.
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
        text, rejected = f"{source} rejected", topic["innovation_rejected"].astype(bool)
        return active_spans(f"estimator{suffix}: {text}", t_s, rejected, text, "flag", REJECTED_S)
    return []


def _flags(topic: Topic, names: Sequence[str]) -> dict[str, Flags]:
    """Flags in separate fields, by their text."""
    return {n.replace("_", " "): topic[n].astype(bool) for n in names if n in topic}


def _bits(topic: Topic, field: str, texts: Mapping[int, str]) -> dict[str, Flags]:
    """Flags that are bits of a field, by their text."""
    if field not in topic:
        return {}
    return {text: topic[field].astype(np.int64) >> bit & 1 == 1 for bit, text in texts.items()}


def _flag_spans(
    lane: str, flags: Mapping[str, Flags], t_s: Values, kind: str = "flag"
) -> list[Span]:
    """Spans of raised flags; one that is always raised is due to the configuration and ignored."""
    return [
        span
        for text, raised in flags.items()
        if not raised.all()
        for span in active_spans(f"{lane}: {text}", t_s, raised, text, kind)
    ]
