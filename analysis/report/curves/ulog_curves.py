"""Which field of which ULog topic is which curve; names as PX4's message definitions have them."""

import numpy as np

from analysis.report.curves.field_values import (
    Columns,
    Curve,
    Reader,
    Values,
    accuracy,
    column,
    degrees,
    euler_deg,
    field,
    largest,
    norm,
    positive,
    used,
)

AXES, NED = ("roll", "pitch", "yaw"), ("north", "east", "down")
MOTORS, CHANNELS, CELLS, IMUS = 12, 8, 14, 4  # shown at the most
SATELLITES = 40  # places in satellite_info


def _euler(part: int, prefix: str = "q") -> Reader:
    return lambda topic: euler_deg(np.stack([column(topic, f"{prefix}[{i}]") for i in range(4)]))[
        part
    ]


def _remaining(topic: Columns) -> Values:
    """Percent; a battery that is not connected has none."""
    connected = topic.get("connected", np.True_)
    return np.where(connected, 100 * column(topic, "remaining"), np.nan)


def _dilution(name: str) -> Reader:
    """A dilution of precision; 99.99 and more say that there is no fix."""
    return lambda topic: np.where(column(topic, name) < 99, column(topic, name), np.nan)


def _noise(strongest: int) -> Reader:
    """C/N0 of the satellite of this rank, dB-Hz; 0 is no satellite."""

    def values(topic: Columns) -> Values:
        names = [f"snr[{i}]" for i in range(SATELLITES) if f"snr[{i}]" in topic]
        ranked = -np.sort(-np.stack([column(topic, name) for name in names]), axis=0)
        return np.where(ranked[strongest - 1] > 0, ranked[strongest - 1], np.nan)

    return values


_ATTITUDE = (
    *(Curve("vehicle_attitude", part, "ATTITUDE", _euler(i)) for i, part in enumerate(AXES)),
    *(
        Curve("vehicle_attitude_setpoint", part, "desired", _euler(i, "q_d"))
        for i, part in enumerate(AXES)
    ),
    *(
        Curve("vehicle_attitude_groundtruth", part, "truth", _euler(i))
        for i, part in enumerate(AXES)
    ),
    *(
        Curve("estimator_attitude", f"instance-{part}", "instance", _euler(i))
        for i, part in enumerate(AXES)
    ),
    *(
        Curve("vehicle_angular_velocity", f"rate-{part}", "actual", degrees(f"xyz[{i}]"))
        for i, part in enumerate(AXES)
    ),
    *(Curve("vehicle_rates_setpoint", f"rate-{part}", "desired", degrees(part)) for part in AXES),
)
_POSITION = (
    Curve("vehicle_global_position", "altitude", "estimate", field("altitude_msl_m")),
    Curve("vehicle_gps_position", "altitude", "GPS", field("altitude_msl_m")),
    # Down to up.
    Curve("vehicle_local_position", "height", "estimate", field("z", -1.0)),
    Curve("vehicle_local_position_setpoint", "height", "desired", field("z", -1.0)),
    Curve("vehicle_local_position", "speed", "ground", norm("vx", "vy")),
    Curve("vehicle_gps_position", "speed", "GPS", field("vel_m_s")),
    Curve("airspeed_validated", "speed", "air", field("calibrated_airspeed_m_s")),
    Curve("vehicle_local_position", "climb", "estimate", field("vz", -1.0)),
    Curve("distance_sensor", "range", "distance sensor", field("current_distance")),
    Curve("wind", "wind", "speed", norm("windspeed_north", "windspeed_east")),
    Curve("estimator_local_position", "instance-down", "instance", field("z")),
    *(
        Curve(topic, f"{kind}-{axis}", name, field(f"{prefix}{letter}"))
        for topic, name in (
            ("vehicle_local_position", "estimate"), ("vehicle_local_position_setpoint", "desired"),
            ("vehicle_local_position_groundtruth", "truth"),
        )
        for kind, prefix in (("velocity", "v"), ("position", ""))
        for letter, axis in zip("xyz", NED, strict=True)
    ),
)  # fmt: skip
_RATIOS = (
    ("vel", "velocity"), ("pos", "horizontal position"), ("hgt", "vertical position"),
    ("mag", "magnetometer"), ("hdg", "heading"), ("tas", "airspeed"),
)  # fmt: skip
_ESTIMATOR = (
    *(
        Curve("estimator_status", "ratio", name, field(f"{word}_test_ratio"))
        for word, name in _RATIOS
    ),
    Curve("estimator_status", "accuracy", "horizontal", accuracy("pos_horiz_accuracy")),
    Curve("estimator_status", "accuracy", "vertical", field("pos_vert_accuracy")),
    *(
        Curve("estimator_sensor_bias", f"{sensor}-bias", axis, field(f"{sensor}_bias[{i}]"))
        for sensor in ("gyro", "accel")
        for i, axis in enumerate("xyz")
    ),
)
_GPS = (
    Curve("vehicle_gps_position", "gps-satellites", "GPS", field("satellites_used")),
    Curve("vehicle_gps_position", "gps-fix", "GPS", field("fix_type")),
    Curve("vehicle_gps_position", "gps-accuracy", "horizontal", accuracy("eph")),
    Curve("vehicle_gps_position", "gps-accuracy", "vertical", accuracy("epv")),
    Curve("vehicle_gps_position", "gps-accuracy", "speed, m/s", field("s_variance_m_s")),
    Curve("vehicle_gps_position", "gps-dilution", "hdop", _dilution("hdop")),
    Curve("vehicle_gps_position", "gps-dilution", "vdop", _dilution("vdop")),
    Curve("vehicle_gps_position", "gps-noise", "jamming indicator", field("jamming_indicator")),
    Curve("vehicle_gps_position", "gps-noise", "noise per ms", field("noise_per_ms")),
    Curve("vehicle_gps_position", "gps-noise", "spoofing state", field("spoofing_state")),
    Curve(
        "vehicle_gps_position", "gps-gain", "automatic gain control",
        field("automatic_gain_control"),
    ),
    Curve("satellite_info", "gps-cn0", "strongest", _noise(1)),
    Curve("satellite_info", "gps-cn0", "fourth strongest", _noise(4)),
)  # fmt: skip
_SENSORS = (
    *(
        Curve("sensor_combined", "accel", axis, field(f"accelerometer_m_s2[{i}]"))
        for i, axis in enumerate("xyz")
    ),
    *(
        Curve("sensor_combined", "gyro", axis, field(f"gyro_rad[{i}]"))
        for i, axis in enumerate("xyz")
    ),
    *(
        Curve(f"sensor_{sensor}", f"{sensor}-instances", axis, field(axis))
        for sensor in ("accel", "gyro")
        for axis in "xyz"
    ),
    *(
        Curve(
            "sensors_status_imu", f"{sensor}-disagreement", f"IMU {i + 1}",
            used(f"{sensor}_inconsistency_{unit}[{i}]"),
        )
        for sensor, unit in (("accel", "m_s_s"), ("gyro", "rad_s"))
        for i in range(IMUS)
    ),
    Curve("sensor_mag", "mag", "compass", norm("x", "y", "z")),
    Curve("vehicle_air_data", "baro", "barometer", field("baro_pressure_pa", 0.01)),
    Curve("sensor_baro", "temperature", "barometer", field("temperature")),
    Curve("sensor_accel", "temperature", "IMU", field("temperature")),
    Curve("vehicle_imu_status", "vibration", "accelerometer", field("accel_vibration_metric")),
    Curve(
        "vehicle_imu_status", "clipping", "accelerometer",
        largest("accel_clipping[0]", "accel_clipping[1]", "accel_clipping[2]"),
    ),
    Curve("failure_detector_status", "imbalance", "propellers", field("imbalanced_prop_metric")),
)  # fmt: skip
_SYSTEM = (
    Curve("battery_status", "battery-voltage", "battery", field("voltage_v")),
    Curve("battery_status", "battery-current", "battery", field("current_a", unknown=-1)),
    Curve("battery_status", "battery-remaining", "battery", _remaining),
    *(
        Curve("battery_status", "battery-cells", f"cell {i + 1}", used(f"voltage_cell_v[{i}]"))
        for i in range(CELLS)
    ),
    Curve("system_power", "board-voltage", "5 V rail", positive("voltage5v_v")),
    Curve("cpuload", "load", "processor", field("load", 100)),
    Curve("cpuload", "load", "memory", field("ram_usage", 100)),
    Curve("telemetry_status", "radio", "frames lost, %", field("rx_message_lost_rate")),
    Curve("input_rc", "radio", "RC signal", positive("rssi")),
)
_CONTROL = (
    *(
        Curve("actuator_motors", "actuators", f"motor {i + 1}", field(f"control[{i}]"))
        for i in range(MOTORS)
    ),
    *(
        Curve("actuator_servos", "servos", f"servo {i + 1}", field(f"control[{i}]"))
        for i in range(CHANNELS)
    ),
    *(
        Curve("actuator_outputs", "outputs", f"output {i + 1}", used(f"output[{i}]"))
        for i in range(MOTORS)
    ),
    *(
        Curve("vehicle_torque_setpoint", "torque", axis, field(f"xyz[{i}]"))
        for i, axis in enumerate(AXES)
    ),
    Curve("vehicle_thrust_setpoint", "throttle", "thrust", norm("xyz[0]", "xyz[1]", "xyz[2]",
                                                                 scale=100)),
    *(
        Curve("control_allocator_status", "unallocated", f"torque {axis}",
              field(f"unallocated_torque[{i}]"))
        for i, axis in enumerate(AXES)
    ),
    *(Curve("manual_control_setpoint", "sticks", name, field(name)) for name in
      ("roll", "pitch", "yaw", "throttle")),
    *(
        Curve("input_rc", "rc", f"channel {i + 1}", used(f"values[{i}]"))
        for i in range(CHANNELS)
    ),
    *(
        Curve("esc_status", "rpm", f"motor {i + 1}", used(f"esc[{i}].esc_rpm"))
        for i in range(CHANNELS)
    ),
)  # fmt: skip
CURVES: tuple[Curve, ...] = (
    *_ATTITUDE, *_POSITION, *_ESTIMATOR, *_GPS, *_SENSORS, *_SYSTEM, *_CONTROL,
)  # fmt: skip
