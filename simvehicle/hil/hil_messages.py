"""Readings in SI units -> the fields of the HIL messages that are not sent at full rate.

Each function returns the values for `mavproxy_fault.wire.frame.build_frame`. Units are those of the
MAVLink definitions, except HIL_GPS.eph and .epv, which PX4 reads as position error in centimetres.
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from mavproxy_fault.numerics.rotations.one_rotation import euler_angles, rotate_to_body
from mavproxy_fault.wire.dialect import Layout, message_layout
from simvehicle.sensors.readings import (
    BatteryReading,
    FlowReading,
    GpsReading,
    RangeReading,
    RemoteControlReading,
    VisionReading,
)

Message = tuple[Layout, Mapping[str, object]]

COURSE_UNKNOWN = 0xFFFF  # HIL_GPS.cog
COURSE_SPEED_MPS = 0.5  # chosen: below it the course over ground is mostly noise
PITCH_270 = 25  # MAV_SENSOR_ROTATION_PITCH_270: looking down
LASER = 0  # MAV_DISTANCE_SENSOR_LASER
LOCAL_NED = 1  # MAV_FRAME_LOCAL_NED
BODY_FRD = 12  # MAV_FRAME_BODY_FRD
VISION = 2  # MAV_ESTIMATOR_TYPE_VISION
UNUSED_CELLS = (0xFFFF,) * 9  # BATTERY_STATUS.voltages after the first: the pack counts as one cell
TEMPERATURE_UNKNOWN = 0x7FFF
STRONGEST_RSSI = 254  # of RC_CHANNELS.rssi


def make_message(name: str, **values: object) -> Message:
    """Make the message `name`; omitted fields are zero."""
    return message_layout(name), values


def statustext(text: str) -> Message:
    """STATUSTEXT for information (MAV_SEVERITY_INFO)."""
    return make_message("STATUSTEXT", severity=6, text=text.encode())


def round_within(value: float, low: int, high: int) -> int:
    """The nearest integer to `value` within the limits of its field."""
    return round(min(max(value, low), high))


def hil_gps(reading: GpsReading, t_us: int) -> Message:
    """HIL_GPS: a receiver's fix."""
    north, east, down = reading.v_ned_mps
    speed = math.hypot(north, east)
    moving = speed >= COURSE_SPEED_MPS
    course = math.degrees(math.atan2(east, north)) % 360.0
    return message_layout("HIL_GPS"), {
        "time_usec": t_us,
        "fix_type": reading.fix_type,
        "lat": round(reading.lat_deg * 1e7),
        "lon": round(reading.lon_deg * 1e7),
        "alt": round(reading.alt_m * 1e3),
        "eph": round_within(reading.eph_m * 100, 0, 0xFFFF),
        "epv": round_within(reading.epv_m * 100, 0, 0xFFFF),
        "vel": round_within(speed * 100, 0, 0xFFFF),
        "vn": round_within(north * 100, -0x8000, 0x7FFF),
        "ve": round_within(east * 100, -0x8000, 0x7FFF),
        "vd": round_within(down * 100, -0x8000, 0x7FFF),
        "cog": round(course * 100) % 36000 if moving else COURSE_UNKNOWN,
        "satellites_visible": reading.satellites,
        "id": reading.id,
    }


def distance_sensor(reading: RangeReading, t_us: int) -> Message:
    """DISTANCE_SENSOR: a downward laser."""
    return message_layout("DISTANCE_SENSOR"), {
        "time_boot_ms": t_us // 1000 & 0xFFFFFFFF,
        "min_distance": round_within(reading.min_m * 100, 0, 0xFFFF),
        "max_distance": round_within(reading.max_m * 100, 0, 0xFFFF),
        "current_distance": round_within(reading.distance_m * 100, 0, 0xFFFF),
        "type": LASER,
        "id": reading.id,
        "orientation": PITCH_270,
        "covariance": 0xFF,  # unknown
    }


def hil_optical_flow(reading: FlowReading, t_us: int) -> Message:
    """HIL_OPTICAL_FLOW: the flow of a downward camera, integrated since the last message."""
    flow_x, flow_y = reading.flow_xy_rad
    gyro_x, gyro_y, gyro_z = reading.gyro_xyz_rad
    return message_layout("HIL_OPTICAL_FLOW"), {
        "time_usec": t_us,
        "integration_time_us": round(reading.integration_s * 1e6),
        "integrated_x": flow_x,
        "integrated_y": flow_y,
        "integrated_xgyro": gyro_x,
        "integrated_ygyro": gyro_y,
        "integrated_zgyro": gyro_z,
        "time_delta_distance_us": 0,
        "distance": reading.distance_m,
        "quality": reading.quality,
    }


def vision_message(reading: VisionReading, t_us: int) -> Message:
    """ODOMETRY or VISION_POSITION_ESTIMATE, depending on the sensor's configuration."""
    return (odometry_message if reading.odometry else vision_position_estimate)(reading, t_us)


def odometry_message(reading: VisionReading, t_us: int) -> Message:
    """ODOMETRY from vision: pose in local NED, velocity in body axes.

    The covariances are upper triangles of 6x6 matrices, row by row; attitude is unknown (NaN).
    """
    velocity = rotate_to_body(reading.q_nb, reading.v_ned_mps)
    return message_layout("ODOMETRY"), {
        "time_usec": t_us,
        "frame_id": LOCAL_NED,
        "child_frame_id": BODY_FRD,
        **dict(zip("xyz", reading.r_ned_m, strict=True)),
        "q": reading.q_nb,
        **dict(zip(("vx", "vy", "vz"), velocity, strict=True)),
        **dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), math.nan),
        "pose_covariance": _covariance_triangle(reading.sigma_r_m**2),
        "velocity_covariance": _covariance_triangle(reading.sigma_v_mps**2),
        "estimator_type": VISION,
        "quality": 100,
    }


def vision_position_estimate(reading: VisionReading, t_us: int) -> Message:
    """VISION_POSITION_ESTIMATE: the pose only, with Euler angles."""
    angles = euler_angles(reading.q_nb)
    return message_layout("VISION_POSITION_ESTIMATE"), {
        "usec": t_us,
        **dict(zip("xyz", reading.r_ned_m, strict=True)),
        **dict(zip(("roll", "pitch", "yaw"), angles, strict=True)),
        "covariance": _covariance_triangle(reading.sigma_r_m**2),
    }


def drawn_mah(before: BatteryReading | None, reading: BatteryReading) -> float:
    """The charge drawn from a battery between two readings [mAh]."""
    hours = 0.0 if before is None else (reading.t_us - before.t_us) / 3.6e9
    return reading.current_a * 1e3 * hours


def battery_status(reading: BatteryReading, consumed_mah: float) -> Message:
    """BATTERY_STATUS: the battery pack as one cell."""
    return message_layout("BATTERY_STATUS"), {
        "current_consumed": round(consumed_mah),
        "energy_consumed": -1,  # not measured
        "temperature": TEMPERATURE_UNKNOWN,
        # Limited to one below the field's maximum, which means an absent cell.
        "voltages": (round_within(reading.voltage_v * 1e3, 0, 0xFFFE), *UNUSED_CELLS),
        "current_battery": round_within(reading.current_a * 100, -0x8000, 0x7FFF),
        "battery_remaining": round_within(reading.remaining * 100, 0, 100),
    }


def rc_channels(reading: RemoteControlReading, t_us: int) -> Message:
    """RC_CHANNELS: what a remote control's receiver outputs."""
    values = {f"chan{number}_raw": width for number, width in enumerate(reading.channels_us, 1)}
    return message_layout("RC_CHANNELS"), {
        "time_boot_ms": t_us // 1000 & 0xFFFFFFFF,
        "chancount": len(values),
        "rssi": STRONGEST_RSSI,
        **values,
    }


@lru_cache(maxsize=8)
def _covariance_triangle(variance: float) -> tuple[float, ...]:
    """Upper triangle of a 6x6 covariance: three equal variances, then three unknown ones (NaN)."""
    matrix = np.diag([variance] * 3 + [math.nan] * 3)
    return tuple(matrix[np.triu_indices(6)].tolist())


# Readings with their own message
READING_MESSAGES: dict[type, Callable[[Any, int], Message]] = {
    GpsReading: hil_gps,
    RangeReading: distance_sensor,
    FlowReading: hil_optical_flow,
    VisionReading: vision_message,
    RemoteControlReading: rc_channels,
}
