"""The arithmetic of the quaternion EKF, compiled; see `ekf` for the layout of x (91,).

What takes a measurement changes the state in place. Plain loops, no slices: assignments of slices
cost seconds of compilation.
"""

from math import atan2

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.estimator import MAX_GAP_S, airspeed_mps, room_for_estimates
from analysis.samples.block import AIRSPEED, FIX, IMU, MAG, Indices, Stamps
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotation_kernel import (
    Axis,
    body_axes,
    quaternion_of_rotation,
    rotate,
    wrapped,
)

Vector = NDArray[np.float64]
P = 10  # where the covariance begins in x
N = 9  # error states: attitude, bias, velocity
MIN_FIX = 3  # GPS_FIX_TYPE_3D_FIX
NOW, GPS, TILT = 0, 1, 2  # stamps: of the state, of the newest velocity, of gravity's last use

Room = NDArray[np.float64]  # (6, 12), for what is only needed in between


@compiled
def new_room() -> Room:
    """Room to work in: made once, used at every sample."""
    return np.empty((6, 12))


@compiled
def predict(
    x: Vector,
    imu: Vector,
    dt_s: float,
    gyro_density: float,
    bias_density: float,
    accel_density: float,
    room: Room,
) -> None:
    """Move state and covariance over one IMU sample, rates and specific force (6,).

    The attitude error obeys t' = -omega x t - b, the velocity's v' = -rot (f x t).
    """
    rx, ry, rz = imu[0] - x[4], imu[1] - x[5], imu[2] - x[6]
    fx, fy, fz = imu[3], imu[4], imu[5]
    # The force is turned to NED by the attitude in the middle of the step: exact to second order.
    half_way = quaternion_of_rotation(0.5 * rx * dt_s, 0.5 * ry * dt_s, 0.5 * rz * dt_s)
    rotate(x, half_way)
    rows = body_axes(x)
    rotate(x, half_way)
    for i in range(3):
        a, b, c = rows[i]
        x[7 + i] += dt_s * (a * fx + b * fy + c * fz)
        room[3 + i, 0] = -dt_s * (b * fz - c * fy)
        room[3 + i, 1] = -dt_s * (c * fx - a * fz)
        room[3 + i, 2] = -dt_s * (a * fy - b * fx)
    # The specific force of free fall is zero; down is positive.
    x[9] += dt_s * STANDARD_GRAVITY_MPS2
    room[0, 0], room[0, 1], room[0, 2] = 1.0, dt_s * rz, -dt_s * ry
    room[1, 0], room[1, 1], room[1, 2] = -dt_s * rz, 1.0, dt_s * rx
    room[2, 0], room[2, 1], room[2, 2] = dt_s * ry, -dt_s * rx, 1.0
    spread(x, room, dt_s)
    for i in range(3):
        x[P + (N + 1) * i] += dt_s * gyro_density * gyro_density
        x[P + (N + 1) * (i + 3)] += dt_s * bias_density * bias_density
        x[P + (N + 1) * (i + 6)] += dt_s * accel_density * accel_density


@compiled
def spread(x: Vector, room: Room, dt_s: float) -> None:
    """Put F P F' in the place of P in x (91,), in place.

    F is the identity but for what the attitude error does to itself and to the velocity's, the
    first three columns of `room`, and for what the bias does to the attitude in `dt_s`. The rows of
    F P that are not P's, attitude and velocity, are put behind those columns.
    """
    for j in range(N):
        attitude_0, attitude_1, attitude_2 = x[P + j], x[P + N + j], x[P + 2 * N + j]
        for i in range(3):
            sum_ = room[i, 0] * attitude_0 + room[i, 1] * attitude_1 + room[i, 2] * attitude_2
            room[i, 3 + j] = sum_ - dt_s * x[P + N * (3 + i) + j]
            sum_ = (
                room[3 + i, 0] * attitude_0
                + room[3 + i, 1] * attitude_1
                + room[3 + i, 2] * attitude_2
            )
            room[3 + i, 3 + j] = sum_ + x[P + N * (6 + i) + j]
    for i in range(3):
        for j in range(3):
            put(x, i, 3 + j, room[i, 6 + j])
            put(x, 3 + j, 6 + i, room[3 + i, 6 + j])
            put(x, i, 6 + j, through(room, i, 3 + j) + room[i, 9 + j])
        for j in range(i, 3):
            put(x, i, j, through(room, i, j) - dt_s * room[i, 6 + j])
            put(x, 6 + i, 6 + j, through(room, 3 + i, 3 + j) + room[3 + i, 9 + j])


@inlined
def put(x: Vector, i: int, j: int, value: float) -> None:
    """Write an element of the covariance in x (91,) and its mirror image."""
    x[P + N * i + j] = value
    x[P + N * j + i] = value


@inlined
def through(room: Room, i: int, j: int) -> float:
    """What row i of F P, in `room`, brings about by row j of the attitude's columns."""
    value: float = room[i, 3] * room[j, 0] + room[i, 4] * room[j, 1] + room[i, 5] * room[j, 2]
    return value


@compiled
def correct(x: Vector, gain: Vector, innovation: float, variance: float) -> None:
    """Take one scalar measurement of innovation variance `variance`; `gain` (9,) is P h."""
    for i in range(N):
        # The upper half; `put` mirrors it, so that the covariance stays symmetric to the last bit.
        for j in range(i, N):
            put(x, i, j, x[P + N * i + j] - gain[i] * gain[j] / variance)
    size = innovation / variance
    # The error is a rotation, not a number to add to the quaternion; its length stays one.
    rotate(x, quaternion_of_rotation(gain[0] * size, gain[1] * size, gain[2] * size))
    for i in range(6):
        x[4 + i] += gain[3 + i] * size


@compiled
def correct_by_rotation(x: Vector, h: Axis, innovation: float, variance: float, room: Room) -> None:
    """Take a scalar measurement that only the attitude error moves, by h (3,), into x (91,)."""
    gain = room[0]
    for i in range(N):
        gain[i] = x[P + N * i] * h[0] + x[P + N * i + 1] * h[1] + x[P + N * i + 2] * h[2]
    variance = variance + h[0] * gain[0] + h[1] * gain[1] + h[2] * gain[2]
    correct(x, gain, innovation, variance)


@compiled
def correct_velocity(x: Vector, v_ned_mps: Vector, variance: float, room: Room) -> None:
    """Take a velocity over ground (3,), axis by axis."""
    gain = room[0]
    for axis in range(3):
        for i in range(N):
            # h picks one velocity out, so that P h is a column of P.
            gain[i] = x[P + N * i + 6 + axis]
        innovation = v_ned_mps[axis] - x[7 + axis]
        correct(x, gain, innovation, variance + gain[6 + axis])


@compiled
def restart_velocity(x: Vector, v_ned_mps: Vector, variance: float) -> None:
    """Take the velocity (3,) in m/s as measured into x (91,) and forget what it had to do with the
    other errors."""
    for i in range(6, N):
        for j in range(N):
            put(x, i, j, 0.0)
    for axis in range(3):
        x[7 + axis] = v_ned_mps[axis]
        put(x, 6 + axis, 6 + axis, variance)


@compiled
def head(x: Vector, field: Vector, declination_rad: float, variance: float, room: Room) -> None:
    """Take the heading of the field (3,): a small rotation e in NED moves it by

    e_d - m_d (e_n m_n + e_e m_e) / (m_n^2 + m_e^2), so that a tilt is not taken for heading.
    """
    fx, fy, fz = field[0], field[1], field[2]
    (n_x, n_y, n_z), (e_x, e_y, e_z), (d_x, d_y, d_z) = body_axes(x)
    north = n_x * fx + n_y * fy + n_z * fz
    east = e_x * fx + e_y * fy + e_z * fz
    # Over a magnetic pole the field has no heading: the small number keeps it finite.
    tilt = -(d_x * fx + d_y * fy + d_z * fz) / (north * north + east * east + 1e-12)
    h = (
        d_x + tilt * (north * n_x + east * e_x),
        d_y + tilt * (north * n_y + east * e_y),
        d_z + tilt * (north * n_z + east * e_z),
    )
    innovation = wrapped(declination_rad - atan2(east, north))
    correct_by_rotation(x, h, innovation, variance, room)


@compiled
def level(x: Vector, imu: Vector, speed_mps: float, variance: float, room: Room) -> None:
    """Take the specific force of an IMU sample (6,) as gravity plus the centripetal part of a
    flight along the nose, axis by axis.

    The attitude error moves gravity in body axes by g x t.
    """
    for axis in range(3):
        # Anew for each axis, as the one before has moved the attitude.
        down = body_axes(x)[2]
        gx, gy, gz = (
            -STANDARD_GRAVITY_MPS2 * down[0],
            -STANDARD_GRAVITY_MPS2 * down[1],
            -STANDARD_GRAVITY_MPS2 * down[2],
        )
        if axis == 0:
            h, expected = (0.0, -gz, gy), gx
        elif axis == 1:
            h, expected = (gz, 0.0, -gx), gy + (imu[2] - x[6]) * speed_mps
        else:
            h, expected = (-gy, gx, 0.0), gz - (imu[1] - x[5]) * speed_mps
        correct_by_rotation(x, h, imu[3 + axis] - expected, variance, room)


@compiled
def moved(
    x: Vector,
    stamps: Stamps,
    t_us: int,
    imu: Vector,
    speed_mps: float,
    numbers: Vector,
    room: Room,
) -> None:
    """Move the state to an IMU sample (6,), and its `stamps` with it."""
    dt_s = (t_us - stamps[NOW]) * 1e-6
    if dt_s <= 0.0:
        return
    # Over a longer gap the IMU tells nothing: the state waits for the other sensors.
    if dt_s <= MAX_GAP_S:
        predict(x, imu, dt_s, numbers[0], numbers[1], numbers[2], room)
    if t_us - stamps[GPS] >= numbers[7] and t_us - stamps[TILT] >= numbers[6]:
        level(x, imu, speed_mps, numbers[5], room)
        stamps[TILT] = t_us
    stamps[NOW] = t_us


@compiled
def with_velocity(
    x: Vector, stamps: Stamps, t_us: int, v: Vector, numbers: Vector, room: Room
) -> None:
    """Take the numbers v (11,) of a fix; one that does not tell the climb is no use."""
    finite = np.isfinite(v[3]) and np.isfinite(v[4]) and np.isfinite(v[5])
    if v[6] < MIN_FIX or not finite:
        return
    if t_us - stamps[GPS] >= numbers[7]:
        restart_velocity(x, v[3:6], numbers[3])
    else:
        correct_velocity(x, v[3:6], numbers[3], room)
    # Fixes may come out of order; the silence counts from the newest.
    stamps[GPS] = max(t_us, stamps[GPS])


@compiled
def follow(
    kind: Indices,
    t_us: Stamps,
    values: Vector,
    x: Vector,
    stamps: Stamps,
    speed_mps: float,
    declination_rad: float,
    numbers: Vector,
) -> tuple[Stamps, Vector, Vector, Stamps, float]:
    """The filter over a block (see `analysis.samples.block`).

    Parameters
    ----------
    kind, t_us, values : (n,), (n,), (n, WIDTH)
    x, stamps, speed_mps : (91,), (3,)
        The state before.
    numbers : (8,)
        Densities of gyro, bias and acceleration, variances of velocity, heading and gravity, how
        often gravity is used and after which silence of GPS, in us.

    Returns
    -------
    Stamps (m,) and q_nb (m, 4) after each IMU sample, and the state after.
    """
    when, q_nb = room_for_estimates(kind)
    x, stamps, room = x.copy(), stamps.copy(), new_room()
    done = 0
    for i in range(len(kind)):
        if kind[i] == IMU:
            moved(x, stamps, t_us[i], values[i], speed_mps, numbers, room)
            when[done] = stamps[NOW]
            for k in range(4):
                q_nb[done, k] = x[k]
            done += 1
        elif kind[i] == MAG:
            head(x, values[i], declination_rad, numbers[4], room)
        elif kind[i] == FIX:
            with_velocity(x, stamps, t_us[i], values[i], numbers, room)
        elif kind[i] == AIRSPEED:
            speed_mps = airspeed_mps(values[i, 0])
    return when, q_nb, x, stamps, speed_mps
