"""Which field of which MAVLink message is which curve: one table.

Units and the values that stand for "unknown" are those of MAVLink's common message set.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.void]
Values = NDArray[np.float64]

GRAVITY_MPS2 = 9.80665
COUNTS_PER_RAD = 1000.0


def field(name: str, scale: float = 1.0, unknown: float | None = None) -> Callable[[Rows], Values]:
    """Values of a field times `scale`; the value `unknown` becomes NaN."""

    def values(rows: Rows) -> Values:
        raw = rows[name].astype(float)
        if unknown is not None:
            raw[raw == unknown] = np.nan
        return raw * scale

    return values


def degrees(name: str) -> Callable[[Rows], Values]:
    """Values of a field in radians as degrees."""
    return field(name, 180 / np.pi)


def heading(name: str, scale: float = 180 / np.pi) -> Callable[[Rows], Values]:
    """A heading in degrees, wrapped to (-180, 180]."""
    return lambda rows: 180 - (180 - rows[name].astype(float) * scale) % 360


def norm(*names: str, scale: float = 1.0) -> Callable[[Rows], Values]:
    """Length of the vector that several fields make."""
    return lambda rows: scale * np.sqrt(sum(rows[name].astype(float) ** 2 for name in names))


def euler(part: int) -> Callable[[Rows], Values]:
    """Roll (0), pitch (1) or yaw (2) in degrees of a quaternion message."""

    def values(rows: Rows) -> Values:
        vector = next(
            (n for n in ("attitude_quaternion", "q") if n in (rows.dtype.names or ())), ""
        )
        q = rows[vector].T if vector else np.stack([rows[n] for n in ("q1", "q2", "q3", "q4")])
        return euler_deg(q.astype(float))[part]

    return values


def euler_deg(q: Values) -> tuple[Values, Values, Values]:
    """Roll, pitch and yaw in degrees of quaternions (w, x, y, z), shape (4, n)."""
    w, x, y, z = q
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.degrees(roll), np.degrees(pitch), np.degrees(yaw)


def cell_volts(rows: Rows) -> Values:
    """Sum of the cells that BATTERY_STATUS gives, volts."""
    cells = rows["voltages"].astype(float)
    cells[cells == 65535] = np.nan
    total = np.nansum(cells, axis=1) * 1e-3
    return np.where(np.isnan(cells).all(axis=1), np.nan, total)


def dilution(name: str) -> Callable[[Rows], Values]:
    """GPS_RAW_INT's eph or epv; 0 and 65535 say that it is unknown, 99.99 that there is no fix."""

    def values(rows: Rows) -> Values:
        raw = rows[name].astype(float)
        return np.where((raw == 0) | (raw >= 9999), np.nan, raw * 1e-2)

    return values


def milli_g(axis: str) -> Callable[[Rows], Values]:
    """An acceleration in thousandths of g as m/s^2."""
    return field(axis, GRAVITY_MPS2 * 1e-3)


Curve = tuple[str, str, str, Callable[[Rows], Values]]

CURVES: tuple[Curve, ...] = (
    ("ATTITUDE", "roll", "ATTITUDE", degrees("roll")),
    ("ATTITUDE", "pitch", "ATTITUDE", degrees("pitch")),
    ("ATTITUDE", "yaw", "ATTITUDE", heading("yaw")),
    ("ATTITUDE_QUATERNION", "roll", "ATTITUDE_QUATERNION", euler(0)),
    ("ATTITUDE_QUATERNION", "pitch", "ATTITUDE_QUATERNION", euler(1)),
    ("ATTITUDE_QUATERNION", "yaw", "ATTITUDE_QUATERNION", euler(2)),
    ("ATTITUDE_TARGET", "roll", "desired", euler(0)),
    ("ATTITUDE_TARGET", "pitch", "desired", euler(1)),
    ("ATTITUDE_TARGET", "yaw", "desired", euler(2)),
    ("AHRS2", "roll", "AHRS2", degrees("roll")),
    ("AHRS2", "pitch", "AHRS2", degrees("pitch")),
    ("AHRS2", "yaw", "AHRS2", heading("yaw")),
    ("HIL_STATE_QUATERNION", "roll", "truth", euler(0)),
    ("HIL_STATE_QUATERNION", "pitch", "truth", euler(1)),
    ("HIL_STATE_QUATERNION", "yaw", "truth", euler(2)),
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
    ("VFR_HUD", "throttle", "throttle", field("throttle")),
    ("ESTIMATOR_STATUS", "ratio", "velocity", field("vel_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "horizontal position", field("pos_horiz_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "vertical position", field("pos_vert_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "magnetometer", field("mag_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "height above ground", field("hagl_ratio")),
    ("ESTIMATOR_STATUS", "ratio", "airspeed", field("tas_ratio")),
    ("ESTIMATOR_STATUS", "accuracy", "horizontal", field("pos_horiz_accuracy")),
    ("ESTIMATOR_STATUS", "accuracy", "vertical", field("pos_vert_accuracy")),
    ("EKF_STATUS_REPORT", "variance", "velocity", field("velocity_variance")),
    ("EKF_STATUS_REPORT", "variance", "horizontal position", field("pos_horiz_variance")),
    ("EKF_STATUS_REPORT", "variance", "vertical position", field("pos_vert_variance")),
    ("EKF_STATUS_REPORT", "variance", "compass", field("compass_variance")),
    ("EKF_STATUS_REPORT", "variance", "terrain", field("terrain_alt_variance")),
    ("GPS_RAW_INT", "gps-satellites", "GPS", field("satellites_visible", 1, 255)),
    ("GPS2_RAW", "gps-satellites", "GPS 2", field("satellites_visible", 1, 255)),
    ("HIL_GPS", "gps-satellites", "HIL_GPS", field("satellites_visible", 1, 255)),
    ("GPS_RAW_INT", "gps-dilution", "eph", dilution("eph")),
    ("GPS_RAW_INT", "gps-dilution", "epv", dilution("epv")),
    ("GPS_RAW_INT", "gps-accuracy", "horizontal", field("h_acc", 1e-3, 0)),
    ("GPS_RAW_INT", "gps-accuracy", "vertical", field("v_acc", 1e-3, 0)),
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
    ("RAW_IMU", "accel", "x (1)", milli_g("xacc")),
    ("RAW_IMU", "accel", "y (1)", milli_g("yacc")),
    ("RAW_IMU", "accel", "z (1)", milli_g("zacc")),
    ("RAW_IMU", "gyro", "x (1)", field("xgyro", 1 / COUNTS_PER_RAD)),
    ("RAW_IMU", "gyro", "y (1)", field("ygyro", 1 / COUNTS_PER_RAD)),
    ("RAW_IMU", "gyro", "z (1)", field("zgyro", 1 / COUNTS_PER_RAD)),
    ("RAW_IMU", "mag", "compass 1", norm("xmag", "ymag", "zmag", scale=1e-3)),
    ("SCALED_IMU2", "accel", "z (2)", milli_g("zacc")),
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
    ("BATTERY_STATUS", "battery-voltage", "BATTERY_STATUS", cell_volts),
    ("BATTERY_STATUS", "battery-remaining", "BATTERY_STATUS", field("battery_remaining", 1, -1)),
    ("POWER_STATUS", "board-voltage", "Vcc", field("Vcc", 1e-3)),
    ("RADIO_STATUS", "radio", "signal", field("rssi", 1, 255)),
    ("RADIO_STATUS", "radio", "remote signal", field("remrssi", 1, 255)),
    ("RADIO_STATUS", "radio", "noise", field("noise", 1, 255)),
    ("RADIO_STATUS", "radio", "remote noise", field("remnoise", 1, 255)),
)
