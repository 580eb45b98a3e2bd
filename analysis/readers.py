"""MAVLink messages -> samples: one function a message, from its numbers in the order of the wire.

HIL_SENSOR carries what `fields_updated` says: bits 0 to 5 acceleration and rates, 6 to 8 the
magnetic field, 9 static pressure, 10 differential pressure, 11 the altitude made of it [1]_.
Vectors of a sample are views of the numbers (k,) they were read from.

References
----------
.. [1] MAVLink common message set, HIL_SENSOR_UPDATED_FLAGS.
"""

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from analysis.samples import (
    AirspeedSample,
    AttitudeSample,
    BaroSample,
    GpsFix,
    ImuSample,
    MagSample,
    RangeSample,
    Sample,
    TruthSample,
    Vector,
    VisionSample,
)
from mavproxy_fault.wire.dialect import known
from simvehicle.rotation import matrix_from_quat, quat_from_euler

IMU_BITS = 0x3F
MAG_BITS = 0x1C0
BARO_BIT = 0x200
AIRSPEED_BIT = 0x400
HECTOPASCAL = 100.0
STANDARD_GRAVITY = 9.80665  # m/s^2, CODATA
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
BODY_FRD = 12  # MAV_FRAME_BODY_FRD
UNKNOWN_16 = 0xFFFF


@cache
def places(name: str) -> dict[str, int]:
    """Where each field of a message begins among its numbers."""
    found, at = {}, 0
    for field in known(name).fields.values():
        found[field.name] = at
        at += max(field.count, 1)
    return found


def _hil_sensor(v: Vector, system: int) -> list[Sample]:
    samples = _highres_imu(v, system)
    t_us, updated = int(v[0]), int(v[14])
    if updated & BARO_BIT:
        samples.append(BaroSample(t_us, HECTOPASCAL * float(v[10]), float(v[12])))
    if updated & AIRSPEED_BIT:
        samples.append(AirspeedSample(t_us, HECTOPASCAL * float(v[11])))
    return samples


def _highres_imu(v: Vector, system: int) -> list[Sample]:
    t_us, updated = int(v[0]), int(v[14])
    samples: list[Sample] = []
    if updated & IMU_BITS == IMU_BITS:
        samples.append(ImuSample(t_us, v[4:7], v[1:4], int(v[15])))
    if updated & MAG_BITS == MAG_BITS:
        samples.append(MagSample(t_us, v[7:10]))
    return samples


def _scaled_imu(v: Vector, system: int) -> list[Sample]:
    accel = v[1:4] * (STANDARD_GRAVITY * 1e-3)
    return [ImuSample(int(v[0]) * 1000, v[4:7] * 1e-3, accel)]


def _named(name: str, v: Vector) -> Callable[[str], float]:
    """The numbers of a message by field."""
    values, at = v.tolist(), places(name)
    return lambda field: float(values[at[field]])


def _accuracy(value: float) -> float:
    return value * 1e-2 if value != UNKNOWN_16 else math.nan


def _fix(
    read: Callable[[str], float], source: str, v_ned: Vector | None, eph_m: float, epv_m: float
) -> list[Sample]:
    """A receiver's solution, from the fields that HIL_GPS and GPS_RAW_INT have in common."""
    return [
        GpsFix(
            t_us=int(read("time_usec")),
            lat_deg=read("lat") * 1e-7,
            lon_deg=read("lon") * 1e-7,
            alt_m=read("alt") * 1e-3,
            v_ned_mps=v_ned,
            fix_type=int(read("fix_type")),
            satellites=int(read("satellites_visible")),
            eph_m=eph_m,
            epv_m=epv_m,
            source=source,
        )
    ]


def _hil_gps(v: Vector, system: int) -> list[Sample]:
    read = _named("HIL_GPS", v)
    v_ned = np.array([read("vn"), read("ve"), read("vd")]) * 1e-2
    return _fix(read, "HIL_GPS", v_ned, _accuracy(read("eph")), _accuracy(read("epv")))


def _gps_raw_int(v: Vector, system: int) -> list[Sample]:
    read = _named("GPS_RAW_INT", v)
    v_ned = None
    if read("vel") != UNKNOWN_16 and read("cog") != UNKNOWN_16:
        course, speed = math.radians(read("cog") * 1e-2), read("vel") * 1e-2
        v_ned = np.array([speed * math.cos(course), speed * math.sin(course), math.nan])
    sigmas = [read(name) * 1e-3 or math.nan for name in ("h_acc", "v_acc")]  # 0 is unknown
    return _fix(read, "GPS_RAW_INT", v_ned, *sigmas)


def _hil_state(v: Vector, system: int) -> list[Sample]:
    lat, lon, alt = v[8:11].tolist()
    return [
        TruthSample(
            t_us=int(v[0]),
            q_nb=v[1:5],
            omega_b_rps=v[5:8],
            lat_deg=lat * 1e-7,
            lon_deg=lon * 1e-7,
            alt_m=alt * 1e-3,
            v_ned_mps=v[11:14] * 1e-2,
        )
    ]


def _distance(v: Vector, system: int) -> list[Sample]:
    read = _named("DISTANCE_SENSOR", v)
    distance = read("current_distance")
    inside = read("min_distance") <= distance <= read("max_distance")
    if read("orientation") != DOWNWARD or not inside:
        return []
    return [RangeSample(int(read("time_boot_ms")) * 1000, distance * 1e-2)]


def _odometry(v: Vector, system: int) -> list[Sample]:
    q_nb, velocity = v[4:8], v[8:11]
    norm = float(np.linalg.norm(q_nb))
    if not norm > 0.0:
        return []
    q_nb = q_nb / norm
    if v[places("ODOMETRY")["child_frame_id"]] == BODY_FRD:
        velocity = matrix_from_quat(q_nb) @ velocity
    return [
        VisionSample(int(v[0]), v[1:4], velocity if np.isfinite(velocity).all() else None, q_nb)
    ]


def _vision(v: Vector, system: int) -> list[Sample]:
    return [VisionSample(int(v[0]), v[1:4], None, quat_from_euler(*v[4:7].tolist()))]


def _attitude(v: Vector, system: int) -> list[Sample]:
    q_nb = quat_from_euler(*v[1:4].tolist())
    return [AttitudeSample(int(v[0]) * 1000, q_nb, system, "ATTITUDE")]


def _attitude_quaternion(v: Vector, system: int) -> list[Sample]:
    return [AttitudeSample(int(v[0]) * 1000, v[1:5], system, "ATTITUDE_QUATERNION")]


READERS: dict[str, Callable[[Vector, int], list[Sample]]] = {
    "HIL_SENSOR": _hil_sensor,
    "HIGHRES_IMU": _highres_imu,
    "SCALED_IMU": _scaled_imu,
    "HIL_GPS": _hil_gps,
    "GPS_RAW_INT": _gps_raw_int,
    "HIL_STATE_QUATERNION": _hil_state,
    "DISTANCE_SENSOR": _distance,
    "ODOMETRY": _odometry,
    "VISION_POSITION_ESTIMATE": _vision,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
}
