"""Table of curves: which field of which MAVLink message gives which curve.

Units and "unknown" values are those of MAVLink's common message set.
"""

import numpy as np

from analysis.report.curves.field_values import (
    Columns,
    LogCurve,
    Reader,
    Values,
    accuracy_field,
    angle_field,
    column,
    element,
    euler_deg,
    field,
    heading_field,
    norm,
    used_field,
)
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

COUNTS_PER_RAD = 1000.0
NO_CELL = 65535
CHANNELS, CELLS, MOTORS = 8, 10, 8  # shown at most


def _euler(part: int) -> Reader:
    """Roll (0), pitch (1) or yaw (2) in degrees from a message with a quaternion."""

    def values(rows: Columns) -> Values:
        vector = next((name for name in ("attitude_quaternion", "q") if name in rows), None)
        if vector is not None:
            return euler_deg(column(rows, vector).T)[part]
        return euler_deg(np.stack([column(rows, name) for name in ("q1", "q2", "q3", "q4")]))[part]

    return values


def _battery_v(rows: Columns) -> Values:
    """Sum of the cell voltages in BATTERY_STATUS, V."""
    cells = column(rows, "voltages")
    cells[cells == NO_CELL] = np.nan
    total = np.nansum(cells, axis=1) * 1e-3
    # Unknown if no cell is known.
    return np.where(np.isnan(cells).all(axis=1), np.nan, total)


def _dilution(name: str) -> Reader:
    """GPS_RAW_INT's eph or epv; NaN if unknown (0, 65535) or without a fix (99.99)."""

    def values(rows: Columns) -> Values:
        raw = column(rows, name)
        # Covers 65535 too.
        return np.where((raw == 0) | (raw >= 9999), np.nan, raw * 1e-2)

    return values


def _milli_g(axis: str) -> Reader:
    """An acceleration in thousandths of g as m/s^2."""
    return field(axis, STANDARD_GRAVITY_MPS2 * 1e-3)


def _milli_rad(axis: str) -> Reader:
    """A rate in thousandths of rad/s as rad/s."""
    return field(axis, 1 / COUNTS_PER_RAD)


def _noise(strongest: int) -> Reader:
    """C/N0 in dB-Hz of the satellite of rank `strongest` in GPS_STATUS; NaN if there is none."""

    def values(rows: Columns) -> Values:
        # Descending: rank 1 is the strongest.
        ranked = -np.sort(-column(rows, "satellite_snr"), axis=1)[:, strongest - 1]
        return np.where(ranked > 0, ranked, np.nan)

    return values


_TABLE: tuple[tuple[str, str, str, Reader], ...] = (
    ("ATTITUDE", "roll", "ATTITUDE", angle_field("roll")),
    ("ATTITUDE", "pitch", "ATTITUDE", angle_field("pitch")),
    ("ATTITUDE", "yaw", "ATTITUDE", heading_field("yaw")),
    ("ATTITUDE_QUATERNION", "roll", "ATTITUDE_QUATERNION", _euler(0)),
    ("ATTITUDE_QUATERNION", "pitch", "ATTITUDE_QUATERNION", _euler(1)),
    ("ATTITUDE_QUATERNION", "yaw", "ATTITUDE_QUATERNION", _euler(2)),
    ("ATTITUDE_TARGET", "roll", "desired", _euler(0)),
    ("ATTITUDE_TARGET", "pitch", "desired", _euler(1)),
    ("ATTITUDE_TARGET", "yaw", "desired", _euler(2)),
    ("AHRS2", "roll", "AHRS2", angle_field("roll")),
    ("AHRS2", "pitch", "AHRS2", angle_field("pitch")),
    ("AHRS2", "yaw", "AHRS2", heading_field("yaw")),
    ("HIL_STATE_QUATERNION", "roll", "truth", _euler(0)),
    ("HIL_STATE_QUATERNION", "pitch", "truth", _euler(1)),
    ("HIL_STATE_QUATERNION", "yaw", "truth", _euler(2)),
    ("HIL_STATE_QUATERNION", "altitude", "truth", field("alt", 1e-3)),
    ("GLOBAL_POSITION_INT", "altitude", "estimate", field("alt", 1e-3)),
    ("GPS_RAW_INT", "altitude", "GPS", field("alt", 1e-3)),
    ("HIL_GPS", "altitude", "HIL_GPS", field("alt", 1e-3)),
    ("GLOBAL_POSITION_INT", "height", "estimate", field("relative_alt", 1e-3)),
    ("VFR_HUD", "speed", "ground", field("groundspeed")),
    ("VFR_HUD", "speed", "air", field("airspeed")),
    ("HIL_GPS", "speed", "HIL_GPS", field("vel", 1e-2, 65535)),
    ("GPS_RAW_INT", "speed", "GPS", field("vel", 1e-2, 65535)),
    ("HIL_STATE_QUATERNION", "speed", "truth", norm("vx", "vy", scale=1e-2)),
    ("VFR_HUD", "climb", "VFR_HUD", field("climb")),
    ("GLOBAL_POSITION_INT", "climb", "estimate", field("vz", -1e-2)),
    ("HIL_STATE_QUATERNION", "climb", "truth", field("vz", -1e-2)),
    ("VFR_HUD", "throttle", "throttle", field("throttle")),
    ("ESTIMATOR_STATUS", "ratio", "velocity", field("vel_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "horizontal position", field("pos_horiz_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "vertical position", field("pos_vert_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "magnetometer", field("mag_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "height above ground", field("hagl_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "airspeed", field("tas_ratio")),
    ("ESTIMATOR_STATUS", "accuracy", "horizontal", accuracy_field("pos_horiz_accuracy")),
    ("ESTIMATOR_STATUS", "accuracy", "vertical", field("pos_vert_accuracy")),
    ("EKF_STATUS_REPORT", "variance", "velocity", field("velocity_variance")),
    ("EKF_STATUS_REPORT", "variance", "horizontal position", field("pos_horiz_variance")),
    ("EKF_STATUS_REPORT", "variance", "vertical position", field("pos_vert_variance")),
    ("EKF_STATUS_REPORT", "variance", "compass", field("compass_variance")),
    ("EKF_STATUS_REPORT", "variance", "terrain", field("terrain_alt_variance")),
    ("GPS_RAW_INT", "gps-satellites", "GPS", field("satellites_visible", 1, 255)),
    ("GPS2_RAW", "gps-satellites", "GPS 2", field("satellites_visible", 1, 255)),
    ("HIL_GPS", "gps-satellites", "HIL_GPS", field("satellites_visible", 1, 255)),
    ("GPS_RAW_INT", "gps-dilution", "eph", _dilution("eph")),
    ("GPS_RAW_INT", "gps-dilution", "epv", _dilution("epv")),
    ("GPS_RAW_INT", "gps-accuracy", "horizontal", accuracy_field("h_acc", 1e-3)),
    ("GPS_RAW_INT", "gps-accuracy", "vertical", accuracy_field("v_acc", 1e-3)),
    ("GPS_RAW_INT", "gps-fix", "GPS", field("fix_type")),
    ("GPS2_RAW", "gps-fix", "GPS 2", field("fix_type")),
    ("HIL_GPS", "gps-fix", "HIL_GPS", field("fix_type")),
    ("HIL_SENSOR", "accel", "x", field("xacc")),
    ("HIL_SENSOR", "accel", "y", field("yacc")),
    ("HIL_SENSOR", "accel", "z", field("zacc")),
    ("HIL_SENSOR", "gyro", "x", field("xgyro")),
    ("HIL_SENSOR", "gyro", "y", field("ygyro")),
    ("HIL_SENSOR", "gyro", "z", field("zgyro")),
    ("HIL_SENSOR", "mag", "HIL_SENSOR", norm("xmag", "ymag", "zmag")),
    ("HIL_SENSOR", "baro", "HIL_SENSOR", field("abs_pressure")),
    ("HIGHRES_IMU", "accel", "x (HIGHRES)", field("xacc")),
    ("HIGHRES_IMU", "accel", "y (HIGHRES)", field("yacc")),
    ("HIGHRES_IMU", "accel", "z (HIGHRES)", field("zacc")),
    ("HIGHRES_IMU", "mag", "HIGHRES_IMU", norm("xmag", "ymag", "zmag")),
    ("RAW_IMU", "accel", "x (1)", _milli_g("xacc")),
    ("RAW_IMU", "accel", "y (1)", _milli_g("yacc")),
    ("RAW_IMU", "accel", "z (1)", _milli_g("zacc")),
    ("RAW_IMU", "gyro", "x (1)", _milli_rad("xgyro")),
    ("RAW_IMU", "gyro", "y (1)", _milli_rad("ygyro")),
    ("RAW_IMU", "gyro", "z (1)", _milli_rad("zgyro")),
    ("RAW_IMU", "mag", "compass 1", norm("xmag", "ymag", "zmag", scale=1e-3)),
    ("SCALED_IMU2", "mag", "compass 2", norm("xmag", "ymag", "zmag", scale=1e-3)),
    ("SCALED_IMU3", "mag", "compass 3", norm("xmag", "ymag", "zmag", scale=1e-3)),
    ("SCALED_PRESSURE", "baro", "barometer", field("press_abs")),
    ("SCALED_PRESSURE", "temperature", "barometer", field("temperature", 1e-2)),
    ("VIBRATION", "vibration", "x", field("vibration_x")),
    ("VIBRATION", "vibration", "y", field("vibration_y")),
    ("VIBRATION", "vibration", "z", field("vibration_z")),
    ("VIBRATION", "clipping", "accelerometer 1", field("clipping_0")),
    ("VIBRATION", "clipping", "accelerometer 2", field("clipping_1")),
    ("VIBRATION", "clipping", "accelerometer 3", field("clipping_2")),
    ("SYS_STATUS", "battery-voltage", "SYS_STATUS", field("voltage_battery", 1e-3, 65535)),
    ("SYS_STATUS", "battery-current", "SYS_STATUS", field("current_battery", 1e-2, -1)),
    ("SYS_STATUS", "battery-remaining", "SYS_STATUS", field("battery_remaining", 1, -1)),
    ("SYS_STATUS", "load", "processor", field("load", 0.1)),
    ("BATTERY_STATUS", "battery-voltage", "BATTERY_STATUS", _battery_v),
    ("BATTERY_STATUS", "battery-remaining", "BATTERY_STATUS", field("battery_remaining", 1, -1)),
    ("POWER_STATUS", "board-voltage", "Vcc", field("Vcc", 1e-3)),
    ("RADIO_STATUS", "radio", "signal", field("rssi", 1, 255)),
    ("RADIO_STATUS", "radio", "remote signal", field("remrssi", 1, 255)),
    # 255 means unknown in RADIO_STATUS.
    ("RADIO_STATUS", "radio", "noise", field("noise", 1, 255)),
    ("RADIO_STATUS", "radio", "remote noise", field("remnoise", 1, 255)),
    *(
        ("ATTITUDE", f"rate-{name}", "actual", angle_field(f"{name}speed"))
        for name in ("roll", "pitch", "yaw")
    ),
    *(
        ("ATTITUDE_TARGET", f"rate-{name}", "desired", angle_field(f"body_{name}_rate"))
        for name in ("roll", "pitch", "yaw")
    ),
    *(
        (message, f"{kind}-{axis}", name, field(f"{prefix}{letter}"))
        for message, name in (
            ("LOCAL_POSITION_NED", "estimate"),
            ("POSITION_TARGET_LOCAL_NED", "desired"),
        )
        for kind, prefix in (("velocity", "v"), ("position", ""))
        for letter, axis in (("x", "north"), ("y", "east"), ("z", "down"))
    ),
    *(
        ("HIL_ACTUATOR_CONTROLS", "actuators", f"motor {i + 1}", element("controls", i))
        for i in range(MOTORS)
    ),
    *(
        ("SERVO_OUTPUT_RAW", "outputs", f"output {i}", used_field(f"servo{i}_raw"))
        for i in range(1, CHANNELS + 1)
    ),
    *(
        ("RC_CHANNELS", "rc", f"channel {i}", used_field(f"chan{i}_raw"))
        for i in range(1, CHANNELS + 1)
    ),
    *(
        ("BATTERY_STATUS", "battery-cells", f"cell {i + 1}", element("voltages", i, 1e-3, NO_CELL))
        for i in range(CELLS)
    ),
    *(("ESC_TELEMETRY_1_TO_4", "rpm", f"motor {i + 1}", element("rpm", i)) for i in range(4)),
    *(("ESC_TELEMETRY_5_TO_8", "rpm", f"motor {i + 5}", element("rpm", i)) for i in range(4)),
    *(("ESC_STATUS", "rpm", f"motor {i + 1}", element("rpm", i)) for i in range(4)),
    *(
        (message, f"{kind}-instances", f"{axis}{suffix}", reader(f"{axis}{word}"))
        for message, suffix in (("RAW_IMU", ""), ("SCALED_IMU2", " 2"), ("SCALED_IMU3", " 3"))
        for kind, word, reader in (("accel", "acc", _milli_g), ("gyro", "gyro", _milli_rad))
        for axis in "xyz"
    ),
    *(("HIGHRES_IMU", "gyro", f"{axis} (HIGHRES)", field(f"{axis}gyro")) for axis in "xyz"),
    ("GPS_STATUS", "gps-cn0", "strongest", _noise(1)),
    ("GPS_STATUS", "gps-cn0", "fourth strongest", _noise(4)),
    ("GPS_RAW_INT", "gps-accuracy", "speed, m/s", field("vel_acc", 1e-3, 0)),
    ("WIND", "wind", "speed", field("speed")),
    ("WIND_COV", "wind", "speed", norm("wind_x", "wind_y")),
    ("DISTANCE_SENSOR", "range", "distance sensor", field("current_distance", 1e-2)),
    ("RANGEFINDER", "range", "distance sensor", field("distance")),
    ("SYS_STATUS", "link-drop", "packets dropped", field("drop_rate_comm", 1e-2)),
    ("POWER_STATUS", "board-voltage", "servo rail", used_field("Vservo", 1e-3)),
    ("MEMINFO", "memory", "free", field("freemem", 1 / 1024)),
    ("HWSTATUS", "board-voltage", "board", used_field("Vcc", 1e-3)),
)
CURVES = tuple(LogCurve(*row) for row in _TABLE)
