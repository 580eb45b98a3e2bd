"""Innovations of PX4's estimator, with the gates beyond which it rejects a measurement.

A measurement is rejected if innovation^2 > gate^2 * variance; the gates are PX4's parameters
(EKF2_GPS_P_GATE and so on, in standard deviations), the variances are logged.
"""

from collections.abc import Mapping

import numpy as np

from analysis.recordings.flight_logs.ulog import Topic
from analysis.report.curves.field_values import DEG, column
from analysis.report.curves.recording import Signal, Vector

# panel, name, field of the topics, scale, gate's parameter and its default
INNOVATIONS = (
    ("innovation-position", "north", "gps_hpos[0]", 1.0, "EKF2_GPS_P_GATE", 5.0),
    ("innovation-position", "east", "gps_hpos[1]", 1.0, "EKF2_GPS_P_GATE", 5.0),
    ("innovation-velocity", "north", "gps_hvel[0]", 1.0, "EKF2_GPS_V_GATE", 5.0),
    ("innovation-velocity", "east", "gps_hvel[1]", 1.0, "EKF2_GPS_V_GATE", 5.0),
    ("innovation-velocity", "down", "gps_vvel", 1.0, "EKF2_GPS_V_GATE", 5.0),
    ("innovation-height", "baro", "baro_vpos", 1.0, "EKF2_BARO_GATE", 5.0),
    ("innovation-height", "GPS", "gps_vpos", 1.0, "EKF2_GPS_P_GATE", 5.0),
    ("innovation-heading", "heading", "heading", DEG, "EKF2_HDG_GATE", 2.6),
    ("innovation-mag", "x", "mag_field[0]", 1.0, "EKF2_MAG_GATE", 3.0),
    ("innovation-mag", "y", "mag_field[1]", 1.0, "EKF2_MAG_GATE", 3.0),
    ("innovation-mag", "z", "mag_field[2]", 1.0, "EKF2_MAG_GATE", 3.0),
    ("innovation-airspeed", "airspeed", "airspeed", 1.0, "EKF2_TAS_GATE", 3.0),
)
GATE = "gate"  # names of gates begin with this


def innovation_signals(
    topics: Mapping[tuple[str, int], Topic], parameters: Mapping[str, float], start_us: int
) -> list[Signal]:
    """Innovations of every estimator instance, and positive and negative gates of the first."""
    found = []
    for (name, instance), topic in sorted(topics.items()):
        if name != "estimator_innovations":
            continue
        variances = topics.get(("estimator_innovation_variances", instance), {})
        suffix = f" {instance + 1}" if instance else ""
        for panel, label, field, scale, parameter, default in INNOVATIONS:
            if field not in topic or not np.nan_to_num(topic[field]).any():
                continue
            found.append(
                Signal(
                    panel, label + suffix, _seconds(topic, start_us), column(topic, field) * scale
                )
            )
            if field in variances and not instance:
                sigmas = parameters.get(parameter, default)
                gate = sigmas * scale * np.sqrt(np.maximum(column(variances, field), 0))
                t_s = _seconds(variances, start_us)
                found.append(Signal(panel, f"{GATE} {label}", t_s, gate))
                found.append(Signal(panel, f"{GATE} {label}, below", t_s, -gate))
    return found


def _seconds(topic: Topic, start_us: int) -> Vector:
    return (topic["timestamp"].astype(np.float64) - start_us) * 1e-6
