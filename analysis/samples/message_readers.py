"""MAVLink messages to samples: one reader function per message, working on columns.

Valid fields of HIL_SENSOR by the bits of `fields_updated`: 0 to 5 acceleration and rates, 6 to 8
magnetic field, 9 static pressure, 10 differential pressure, 11 pressure altitude
[1]_.

References
----------
.. [1] MAVLink common message set, HIL_SENSOR_UPDATED_FLAGS.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import (
    AIRSPEED,
    ATTITUDE,
    BARO,
    COMMAND,
    COMMAND_SOURCE,
    CONTROLS,
    FIX,
    IMU,
    MAG,
    OUTPUTS,
    RANGE,
    SOURCES,
    SPARE,
    SPARE_NUMBERS,
    TRUTH,
    VISION,
    Indices,
    Stamps,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat, quat_from_euler

Rows = NDArray[np.void]

IMU_BITS = 0x3F
MAG_BITS = 0x1C0
BARO_BIT = 0x200
AIRSPEED_BIT = 0x400
# MAVLink gives pressure in hectopascal (millibar).
HECTOPASCAL = 100.0
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
BODY_FRD = 12  # MAV_FRAME_BODY_FRD
FIX_3D = 3  # GPS_FIX_TYPE
# MAVLink's "unknown" in unsigned 16-bit fields.
UNKNOWN_16 = 0xFFFF
PER_OUTPUT = 1e-3  # command units per microsecond of pulse width


class ReadSamples(NamedTuple):
    """Samples of one kind: their rows in the message, timestamps and values (m, k)."""

    kind: int
    row: Indices
    t_us: Stamps
    values: Vector


def _numbers(rows: Rows, *names: str) -> Vector:
    """Fields of a message side by side (m, k); a field may be an array."""
    fields = [f if f.ndim > 1 else f[:, np.newaxis] for f in (rows[name] for name in names)]
    found = np.empty((len(rows), sum(field.shape[1] for field in fields)))
    end = 0
    for field in fields:
        begin, end = end, end + field.shape[1]
        found[:, begin:end] = field
    return found


def _read_all(kind: int, t_us: NDArray[Any], values: Vector) -> list[ReadSamples]:
    """One sample per row."""
    return [ReadSamples(kind, np.arange(len(t_us)), t_us, values)]


def _read_flagged(
    rows: Rows, bits: int, kind: int, values: Callable[[Rows], Vector]
) -> list[ReadSamples]:
    """One sample per row in which all of `bits` are set."""
    # All bits are required: a sample with one stale axis is unusable.
    row = np.flatnonzero(rows["fields_updated"] & bits == bits)
    if not len(row):
        return []
    found = rows if len(row) == len(rows) else rows.take(row)  # a tenth of the time of rows[row]
    return [ReadSamples(kind, row, found["time_usec"].astype(np.int64), values(found))]


def _hil_sensor(rows: Rows) -> list[ReadSamples]:
    return [
        *_highres_imu(rows),
        *_read_flagged(rows, BARO_BIT, BARO, _pressure),
        *_read_flagged(
            rows,
            AIRSPEED_BIT,
            AIRSPEED,
            lambda found: HECTOPASCAL * _numbers(found, "diff_pressure"),
        ),
    ]


def _pressure(rows: Rows) -> Vector:
    return _numbers(rows, "abs_pressure", "pressure_alt") * (HECTOPASCAL, 1.0)


def _highres_imu(rows: Rows) -> list[ReadSamples]:
    names = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "id")
    return [
        *_read_flagged(rows, IMU_BITS, IMU, lambda found: _numbers(found, *names)),
        *_read_flagged(rows, MAG_BITS, MAG, lambda found: _numbers(found, "xmag", "ymag", "zmag")),
    ]


# Milliseconds since boot.
def _since_boot(rows: Rows) -> Stamps:
    stamps: Stamps = rows["time_boot_ms"].astype(np.int64) * 1000
    return stamps


def _scaled_imu(rows: Rows) -> list[ReadSamples]:
    return _read_all(IMU, _since_boot(rows), _scaled(rows))


def _scaled(rows: Rows) -> Vector:
    """Angular rates and specific force (m, 6) in rad/s and m/s^2."""
    # Milliradians per second and thousandths of gravity.
    rates = _numbers(rows, "xgyro", "ygyro", "zgyro") * 1e-3
    force = _numbers(rows, "xacc", "yacc", "zacc") * (STANDARD_GRAVITY_MPS2 * 1e-3)
    return np.column_stack([rates, force])


def _further_imu(number: int) -> Callable[[Rows], list[ReadSamples]]:
    """SCALED_IMU2 and 3, for voting among IMUs."""
    return lambda rows: _read_all(SPARE, _since_boot(rows), _spare(IMU, number, _scaled(rows)))


def _spare(kind: int, number: int, numbers: Vector) -> Vector:
    """Rows of a redundant sensor from its values (m, n)."""
    known = np.full((len(numbers), SPARE_NUMBERS), (kind, number), float)
    return np.column_stack([known, numbers])


def _fix(rows: Rows, source: str, v_ned: Vector, accuracy_m: Vector) -> list[ReadSamples]:
    """A receiver's fix from the fields common to HIL_GPS and GPS_RAW_INT."""
    # Degrees by 1e7, millimetres above mean sea level.
    place = _numbers(rows, "lat", "lon", "alt") * (1e-7, 1e-7, 1e-3)
    state = _numbers(rows, "fix_type", "satellites_visible")
    number = np.full(len(rows), float(SOURCES.index(source)))
    values = np.column_stack([place, v_ned, state, accuracy_m, number])
    return _read_all(FIX, rows["time_usec"].astype(np.int64), values)


def _hil_gps(rows: Rows) -> list[ReadSamples]:
    accuracy = _numbers(rows, "eph", "epv")
    # Centimetres; 65535 means unknown in HIL_GPS.
    accuracy_m = np.where(accuracy != UNKNOWN_16, accuracy * 1e-2, np.nan)
    return _fix(rows, "HIL_GPS", _numbers(rows, "vn", "ve", "vd") * 1e-2, accuracy_m)


def _second_fix(rows: Rows) -> list[ReadSamples]:
    """The position of a second receiver, for voting among receivers."""
    row = np.flatnonzero(rows["fix_type"] >= FIX_3D)
    place = _numbers(rows[row], "lat", "lon", "alt") * (1e-7, 1e-7, 1e-3)
    t_us = rows["time_usec"][row].astype(np.int64)
    return [ReadSamples(SPARE, row, t_us, _spare(FIX, 1, place))]


def _gps_raw_int(rows: Rows) -> list[ReadSamples]:
    """The horizontal velocity follows from speed and course; an accuracy of 0 is unknown."""
    # Centimetres per second and hundredths of a degree.
    speed, course = rows["vel"] * 1e-2, np.radians(rows["cog"] * 1e-2)
    known = (rows["vel"] != UNKNOWN_16) & (rows["cog"] != UNKNOWN_16)
    # Vertical speed is not in this message: it stays NaN.
    v_ned = np.full((len(rows), 3), np.nan)
    v_ned[known, 0] = (speed * np.cos(course))[known]
    v_ned[known, 1] = (speed * np.sin(course))[known]
    accuracy_m = _numbers(rows, "h_acc", "v_acc") * 1e-3
    return _fix(rows, "GPS_RAW_INT", v_ned, np.where(accuracy_m != 0.0, accuracy_m, np.nan))


def _hil_state(rows: Rows) -> list[ReadSamples]:
    # The columns after the angular ones are MAVLink's integers: degrees by 1e7, mm and cm/s.
    angular = ("attitude_quaternion", "rollspeed", "pitchspeed", "yawspeed")
    values = _numbers(rows, *angular, "lat", "lon", "alt", "vx", "vy", "vz")
    values[:, 7:] *= (1e-7, 1e-7, 1e-3, 1e-2, 1e-2, 1e-2)
    return _read_all(TRUTH, rows["time_usec"].astype(np.int64), values)


def _distance(rows: Rows) -> list[ReadSamples]:
    """Distance to the ground; NaN at or beyond the sensor's limits (received, but unusable)."""
    row = np.flatnonzero(rows["orientation"] == DOWNWARD)
    rows = rows[row]
    distance = rows["current_distance"]
    inside = (rows["min_distance"] < distance) & (distance < rows["max_distance"])
    measured_m = np.where(inside, distance * 1e-2, np.nan)  # from centimetres
    return [ReadSamples(RANGE, row, _since_boot(rows), measured_m[:, np.newaxis])]


def _odometry(rows: Rows) -> list[ReadSamples]:
    q_nb, v = _numbers(rows, "q"), _numbers(rows, "vx", "vy", "vz")
    norm = np.linalg.norm(q_nb, axis=1)
    # An all-zero quaternion means that there is no attitude.
    row = np.flatnonzero(norm > 0.0)
    q_nb, v = q_nb[row] / norm[row, None], v[row]
    body = rows["child_frame_id"][row] == BODY_FRD
    # Velocity in body axes is rotated to NED by the attitude of the same message.
    v[body] = np.einsum("nij,nj->ni", matrix_from_quat(q_nb[body]), v[body])
    # A velocity with an unknown component is unknown.
    v[~np.isfinite(v).all(axis=1)] = np.nan
    values = np.column_stack([_numbers(rows[row], "x", "y", "z"), v, q_nb])
    return [ReadSamples(VISION, row, rows["time_usec"][row].astype(np.int64), values)]


def _vision(rows: Rows) -> list[ReadSamples]:
    unknown = np.full((len(rows), 3), np.nan)
    values = np.column_stack([_numbers(rows, "x", "y", "z"), unknown, _attitudes(rows)])
    return _read_all(VISION, rows["usec"].astype(np.int64), values)


def _attitudes(rows: Rows) -> Vector:
    """Attitudes (m, 4) of Euler angles."""
    return quat_from_euler(*_numbers(rows, "roll", "pitch", "yaw").T)


def _attitude(rows: Rows) -> list[ReadSamples]:
    return _estimate(rows, _attitudes(rows), "ATTITUDE")


def _attitude_quaternion(rows: Rows) -> list[ReadSamples]:
    return _estimate(rows, _numbers(rows, "q1", "q2", "q3", "q4"), "ATTITUDE_QUATERNION")


def _estimate(rows: Rows, q_nb: Vector, source: str) -> list[ReadSamples]:
    number = np.full(len(rows), float(SOURCES.index(source)))
    values = np.column_stack([q_nb, rows["system"].astype(float), number])
    return _read_all(ATTITUDE, _since_boot(rows), values)


def _actuator_controls(rows: Rows) -> list[ReadSamples]:
    """The first outputs; a non-finite value means that the output is off."""
    return _commands(rows, _numbers(rows, "controls"), CONTROLS)


def _servo_outputs(rows: Rows) -> list[ReadSamples]:
    """The main outputs; those of an extension board (another port) are ignored."""
    names = [f"servo{i + 1}_raw" for i in range(COMMAND_SOURCE)]
    main = np.flatnonzero(rows["port"] == 0)
    values = _numbers(rows[main], *names) * PER_OUTPUT
    return [read._replace(row=main) for read in _commands(rows[main], values, OUTPUTS)]


def _output_status(rows: Rows) -> list[ReadSamples]:
    return _commands(rows, _numbers(rows, "actuator") * PER_OUTPUT, OUTPUTS)


def _commands(rows: Rows, values: Vector, source: int) -> list[ReadSamples]:
    outputs = values[:, :COMMAND_SOURCE]
    outputs[~np.isfinite(outputs)] = 0.0
    known = np.column_stack([outputs, np.full(len(rows), float(source))])
    return _read_all(COMMAND, rows["time_usec"].astype(np.int64), known)


READERS: dict[str, Callable[[Rows], list[ReadSamples]]] = {
    "HIL_SENSOR": _hil_sensor,
    "HIGHRES_IMU": _highres_imu,
    "SCALED_IMU": _scaled_imu,
    "SCALED_IMU2": _further_imu(1),
    "SCALED_IMU3": _further_imu(2),
    "HIL_GPS": _hil_gps,
    "GPS_RAW_INT": _gps_raw_int,
    "GPS2_RAW": _second_fix,
    "HIL_STATE_QUATERNION": _hil_state,
    "HIL_ACTUATOR_CONTROLS": _actuator_controls,
    "SERVO_OUTPUT_RAW": _servo_outputs,
    "ACTUATOR_OUTPUT_STATUS": _output_status,
    "DISTANCE_SENSOR": _distance,
    "ODOMETRY": _odometry,
    "VISION_POSITION_ESTIMATE": _vision,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
}
