"""Table of curves: which field of which ULog topic gives which curve; names as in PX4's
messages."""

import numpy as np

from analysis.report.curves.field_values import (
    Columns,
    LogCurve,
    Reader,
    Values,
    accuracy_field,
    angle_field,
    column,
    euler_deg,
    field,
    largest_field,
    norm,
    positive_field,
    used_field,
)

AXES, NED = ("roll", "pitch", "yaw"), ("north", "east", "down")
MOTORS, CHANNELS, CELLS, IMUS = 12, 8, 14, 4  # shown at most
SATELLITES = 40  # array length of satellite_info


def _euler(part: int, prefix: str = "q") -> Reader:
    return lambda topic: euler_deg(np.stack([column(topic, f"{prefix}[{i}]") for i in range(4)]))[
        part
    ]


def _remaining(topic: Columns) -> Values:
    """Remaining battery in percent; NaN if not connected."""
    connected = topic.get("connected", np.True_)
    return np.where(connected, 100 * column(topic, "remaining"), np.nan)


def _dilution(name: str) -> Reader:
    """A dilution of precision; NaN from 99 on, which means no fix."""
    return lambda topic: np.where(column(topic, name) < 99, column(topic, name), np.nan)


def _noise(strongest: int) -> Reader:
    """C/N0 in dB-Hz of the satellite of rank `strongest`; NaN if there is none."""

    def values(topic: Columns) -> Values:
        names = [f"snr[{i}]" for i in range(SATELLITES) if f"snr[{i}]" in topic]
        ranked = -np.sort(-np.stack([column(topic, name) for name in names]), axis=0)
        return np.where(ranked[strongest - 1] > 0, ranked[strongest - 1], np.nan)

    return values


_ATTITUDE = (
    *(LogCurve("vehicle_attitude", part, "ATTITUDE", _euler(i)) for i, part in enumerate(AXES)),
    *(
        LogCurve("vehicle_attitude_setpoint", part, "desired", _euler(i, "q_d"))
        for i, part in enumerate(AXES)
    ),
    *(
        LogCurve("vehicle_attitude_groundtruth", part, "truth", _euler(i))
        for i, part in enumerate(AXES)
    ),
    *(
        LogCurve("estimator_attitude", f"instance-{part}", "instance", _euler(i))
        for i, part in enumerate(AXES)
    ),
    *(
        LogCurve("vehicle_angular_velocity", f"rate-{part}", "actual", angle_field(f"xyz[{i}]"))
        for i, part in enumerate(AXES)
    ),
    *(
        LogCurve("vehicle_rates_setpoint", f"rate-{part}", "desired", angle_field(part))
        for part in AXES
    ),
)
_POSITION = (
    LogCurve("vehicle_global_position", "altitude", "estimate", field("altitude_msl_m")),
    LogCurve("vehicle_gps_position", "altitude", "GPS", field("altitude_msl_m")),
    # Down to up.
    LogCurve("vehicle_local_position", "height", "estimate", field("z", -1.0)),
    LogCurve("vehicle_local_position_setpoint", "height", "desired", field("z", -1.0)),
    LogCurve("vehicle_local_position", "speed", "ground", norm("vx", "vy")),
    LogCurve("vehicle_gps_position", "speed", "GPS", field("vel_m_s")),
    LogCurve("airspeed_validated", "speed", "air", field("calibrated_airspeed_m_s")),
    LogCurve("vehicle_local_position", "climb", "estimate", field("vz", -1.0)),
    LogCurve("vehicle_local_position_groundtruth", "climb", "truth", field("vz", -1.0)),
    LogCurve("vehicle_local_position_groundtruth", "height", "truth", field("z", -1.0)),
    LogCurve("distance_sensor", "range", "distance sensor", field("current_distance")),
    LogCurve("wind", "wind", "speed", norm("windspeed_north", "windspeed_east")),
    LogCurve("estimator_local_position", "instance-down", "instance", field("z")),
    *(
        LogCurve(topic, f"{kind}-{axis}", name, field(f"{prefix}{letter}"))
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
        LogCurve("estimator_status", "ratio", name, field(f"{word}_test_ratio"))
        for word, name in _RATIOS
    ),
    LogCurve("estimator_status", "accuracy", "horizontal", accuracy_field("pos_horiz_accuracy")),
    LogCurve("estimator_status", "accuracy", "vertical", field("pos_vert_accuracy")),
    *(
        LogCurve("estimator_sensor_bias", f"{sensor}-bias", axis, field(f"{sensor}_bias[{i}]"))
        for sensor in ("gyro", "accel")
        for i, axis in enumerate("xyz")
    ),
)
_GPS = (
    LogCurve("vehicle_gps_position", "gps-satellites", "GPS", field("satellites_used")),
    LogCurve("vehicle_gps_position", "gps-fix", "GPS", field("fix_type")),
    LogCurve("vehicle_gps_position", "gps-accuracy", "horizontal", accuracy_field("eph")),
    LogCurve("vehicle_gps_position", "gps-accuracy", "vertical", accuracy_field("epv")),
    LogCurve("vehicle_gps_position", "gps-accuracy", "speed, m/s", field("s_variance_m_s")),
    LogCurve("vehicle_gps_position", "gps-dilution", "hdop", _dilution("hdop")),
    LogCurve("vehicle_gps_position", "gps-dilution", "vdop", _dilution("vdop")),
    LogCurve("vehicle_gps_position", "gps-noise", "jamming indicator", field("jamming_indicator")),
    LogCurve("vehicle_gps_position", "gps-noise", "noise per ms", field("noise_per_ms")),
    LogCurve("vehicle_gps_position", "gps-noise", "spoofing state", field("spoofing_state")),
    LogCurve(
        "vehicle_gps_position", "gps-gain", "automatic gain control",
        field("automatic_gain_control"),
    ),
    LogCurve("satellite_info", "gps-cn0", "strongest", _noise(1)),
    LogCurve("satellite_info", "gps-cn0", "fourth strongest", _noise(4)),
)  # fmt: skip
_SENSORS = (
    *(
        LogCurve("sensor_combined", "accel", axis, field(f"accelerometer_m_s2[{i}]"))
        for i, axis in enumerate("xyz")
    ),
    *(
        LogCurve("sensor_combined", "gyro", axis, field(f"gyro_rad[{i}]"))
        for i, axis in enumerate("xyz")
    ),
    *(
        LogCurve(f"sensor_{sensor}", f"{sensor}-instances", axis, field(axis))
        for sensor in ("accel", "gyro")
        for axis in "xyz"
    ),
    *(
        LogCurve(
            "sensors_status_imu", f"{sensor}-disagreement", f"IMU {i + 1}",
            used_field(f"{sensor}_inconsistency_{unit}[{i}]"),
        )
        for sensor, unit in (("accel", "m_s_s"), ("gyro", "rad_s"))
        for i in range(IMUS)
    ),
    LogCurve("sensor_mag", "mag", "compass", norm("x", "y", "z")),
    LogCurve("vehicle_air_data", "baro", "barometer", field("baro_pressure_pa", 0.01)),
    LogCurve("sensor_baro", "temperature", "barometer", field("temperature")),
    LogCurve("sensor_accel", "temperature", "IMU", field("temperature")),
    LogCurve("vehicle_imu_status", "vibration", "accelerometer", field("accel_vibration_metric")),
    LogCurve(
        "vehicle_imu_status", "clipping", "accelerometer",
        largest_field("accel_clipping[0]", "accel_clipping[1]", "accel_clipping[2]"),
    ),
    LogCurve("failure_detector_status", "imbalance", "propellers", field("imbalanced_prop_metric")),
)  # fmt: skip
_SYSTEM = (
    LogCurve("battery_status", "battery-voltage", "battery", field("voltage_v")),
    LogCurve("battery_status", "battery-current", "battery", field("current_a", unknown=-1)),
    LogCurve("battery_status", "battery-remaining", "battery", _remaining),
    *(
        LogCurve(
            "battery_status", "battery-cells", f"cell {i + 1}", used_field(f"voltage_cell_v[{i}]")
        )
        for i in range(CELLS)
    ),
    LogCurve("system_power", "board-voltage", "5 V rail", positive_field("voltage5v_v")),
    LogCurve("cpuload", "load", "processor", field("load", 100)),
    LogCurve("cpuload", "load", "memory", field("ram_usage", 100)),
    LogCurve("telemetry_status", "radio", "frames lost, %", field("rx_message_lost_rate")),
    LogCurve("input_rc", "radio", "RC signal", positive_field("rssi")),
)
_CONTROL = (
    *(
        LogCurve("actuator_motors", "actuators", f"motor {i + 1}", field(f"control[{i}]"))
        for i in range(MOTORS)
    ),
    *(
        LogCurve("actuator_servos", "servos", f"servo {i + 1}", field(f"control[{i}]"))
        for i in range(CHANNELS)
    ),
    *(
        LogCurve("actuator_outputs", "outputs", f"output {i + 1}", used_field(f"output[{i}]"))
        for i in range(MOTORS)
    ),
    *(
        LogCurve("vehicle_torque_setpoint", "torque", axis, field(f"xyz[{i}]"))
        for i, axis in enumerate(AXES)
    ),
    LogCurve("vehicle_thrust_setpoint", "throttle", "thrust", norm("xyz[0]", "xyz[1]", "xyz[2]",
                                                                 scale=100)),
    *(
        LogCurve("control_allocator_status", "unallocated", f"torque {axis}",
              field(f"unallocated_torque[{i}]"))
        for i, axis in enumerate(AXES)
    ),
    *(LogCurve("manual_control_setpoint", "sticks", name, field(name)) for name in
      ("roll", "pitch", "yaw", "throttle")),
    *(
        LogCurve("input_rc", "rc", f"channel {i + 1}", used_field(f"values[{i}]"))
        for i in range(CHANNELS)
    ),
    *(
        LogCurve("esc_status", "rpm", f"motor {i + 1}", used_field(f"esc[{i}].esc_rpm"))
        for i in range(CHANNELS)
    ),
)  # fmt: skip
CURVES: tuple[LogCurve, ...] = (
    *_ATTITUDE, *_POSITION, *_ESTIMATOR, *_GPS, *_SENSORS, *_SYSTEM, *_CONTROL,
)  # fmt: skip
