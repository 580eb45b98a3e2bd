"""The arithmetic of the quaternion EKF, compiled; see `ekf` for the layout of x (91,).

What takes a measurement changes the state in place. Plain loops, no slices: assignments of slices
cost seconds of compilation.
"""

from math import atan2
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.estimator import MAX_GAP_S, airspeed_mps, empty_estimates
from analysis.samples.block import (
    AIRSPEED,
    FIX,
    FIX_TYPE,
    FIX_VELOCITY,
    FORCE,
    IMU,
    MAG,
    Indices,
    Stamps,
)
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    Axis,
    body_axes,
    quaternion_of_rotation,
    rotate_in_place,
    wrap_angle,
)

Vector = NDArray[np.float64]
BIAS, VELOCITY, P = 4, 7, 10  # where they and the covariance begin in x, behind the quaternion
N = 9  # error states: attitude, bias, velocity
D_BIAS, D_VELOCITY = 3, 6  # where these begin among them
MIN_FIX = 3  # GPS_FIX_TYPE_3D_FIX
STATE, GPS, TILT = 0, 1, 2  # stamps: of the state, of the newest velocity, of gravity's last use

Workspace = NDArray[np.float64]  # (6, 12), for what is only needed in between
FP = 3  # where the rows of F P begin in it, behind the three columns of F


class Tuning(NamedTuple):
    """Densities of the noise of gyro [rad/s/rt(Hz)], its bias and the acceleration, variances of
    velocity, heading and gravity, how often gravity is used and after which silence of GPS [s]."""

    gyro_density: float
    bias_density: float
    accel_density: float
    velocity_variance: float
    heading_variance: float
    gravity_variance: float
    gravity_period_s: float
    gps_timeout_s: float


@compiled
def new_workspace() -> Workspace:
    """Room to work in: made once, used at every sample."""
    return np.empty((6, 12))


@compiled
def predict(
    x: Vector,
    imu: Vector,
    dt_s: float,
    tuning: Tuning,
    room: Workspace,
) -> None:
    """Move state and covariance over one IMU sample, rates and specific force (6,).

    The attitude error obeys t' = -omega x t - b, the velocity's v' = -rot (f x t).
    """
    rx, ry, rz = imu[0] - x[BIAS], imu[1] - x[BIAS + 1], imu[2] - x[BIAS + 2]
    fx, fy, fz = imu[FORCE], imu[FORCE + 1], imu[FORCE + 2]
    # The force is turned to NED by the attitude in the middle of the step: exact to second order.
    half_way = quaternion_of_rotation(0.5 * rx * dt_s, 0.5 * ry * dt_s, 0.5 * rz * dt_s)
    rotate_in_place(x, half_way)
    rows = body_axes(x)
    rotate_in_place(x, half_way)
    for i in range(3):
        a, b, c = rows[i]
        x[VELOCITY + i] += dt_s * (a * fx + b * fy + c * fz)
        room[3 + i, 0] = -dt_s * (b * fz - c * fy)
        room[3 + i, 1] = -dt_s * (c * fx - a * fz)
        room[3 + i, 2] = -dt_s * (a * fy - b * fx)
    # The specific force of free fall is zero; down is positive.
    x[VELOCITY + 2] += dt_s * STANDARD_GRAVITY_MPS2
    room[0, 0], room[0, 1], room[0, 2] = 1.0, dt_s * rz, -dt_s * ry
    room[1, 0], room[1, 1], room[1, 2] = -dt_s * rz, 1.0, dt_s * rx
    room[2, 0], room[2, 1], room[2, 2] = dt_s * ry, -dt_s * rx, 1.0
    propagate_covariance(x, room, dt_s)
    for i in range(3):
        x[P + (N + 1) * i] += dt_s * tuning.gyro_density * tuning.gyro_density
        x[P + (N + 1) * (D_BIAS + i)] += dt_s * tuning.bias_density * tuning.bias_density
        x[P + (N + 1) * (D_VELOCITY + i)] += dt_s * tuning.accel_density * tuning.accel_density


@compiled
def propagate_covariance(x: Vector, room: Workspace, dt_s: float) -> None:
    """Put F P F' in the place of P in x (91,), in place.

    F is the identity but for what the attitude error does to itself and to the velocity's, the
    first three columns of `room`, and for what the bias does to the attitude in `dt_s`. The rows of
    F P that are not P's, attitude and velocity, are put behind those columns.
    """
    for j in range(N):
        attitude_0, attitude_1, attitude_2 = x[P + j], x[P + N + j], x[P + 2 * N + j]
        for i in range(3):
            sum_ = room[i, 0] * attitude_0 + room[i, 1] * attitude_1 + room[i, 2] * attitude_2
            room[i, FP + j] = sum_ - dt_s * x[P + N * (D_BIAS + i) + j]
            sum_ = (
                room[3 + i, 0] * attitude_0
                + room[3 + i, 1] * attitude_1
                + room[3 + i, 2] * attitude_2
            )
            room[3 + i, FP + j] = sum_ + x[P + N * (D_VELOCITY + i) + j]
    for i in range(3):
        for j in range(3):
            set_symmetric(x, i, D_BIAS + j, room[i, FP + D_BIAS + j])
            set_symmetric(x, D_BIAS + j, D_VELOCITY + i, room[3 + i, FP + D_BIAS + j])
            moved_velocity = attitude_product(room, i, 3 + j) + room[i, FP + D_VELOCITY + j]
            set_symmetric(x, i, D_VELOCITY + j, moved_velocity)
        for j in range(i, 3):
            set_symmetric(x, i, j, attitude_product(room, i, j) - dt_s * room[i, FP + D_BIAS + j])
            moved_velocity = attitude_product(room, 3 + i, 3 + j) + room[3 + i, FP + D_VELOCITY + j]
            set_symmetric(x, D_VELOCITY + i, D_VELOCITY + j, moved_velocity)


@inlined
def set_symmetric(x: Vector, i: int, j: int, value: float) -> None:
    """Write an element of the covariance in x (91,) and its mirror image."""
    x[P + N * i + j] = value
    x[P + N * j + i] = value


@inlined
def attitude_product(room: Workspace, i: int, j: int) -> float:
    """What row i of F P, in `room`, brings about by row j of the attitude's columns."""
    row, column = room[i], room[j]
    value: float = row[FP] * column[0] + row[FP + 1] * column[1] + row[FP + 2] * column[2]
    return value


@compiled
def apply_correction(x: Vector, gain: Vector, innovation: float, variance: float) -> None:
    """Take one scalar measurement of innovation variance `variance`; `gain` (9,) is P h."""
    for i in range(N):
        # The upper half; `set_symmetric` mirrors it, so that the covariance stays symmetric to the
        # last bit.
        for j in range(i, N):
            set_symmetric(x, i, j, x[P + N * i + j] - gain[i] * gain[j] / variance)
    size = innovation / variance
    # The error is a rotation, not a number to add to the quaternion; its length stays one.
    rotate_in_place(x, quaternion_of_rotation(gain[0] * size, gain[1] * size, gain[2] * size))
    for i in range(N - D_BIAS):
        x[BIAS + i] += gain[D_BIAS + i] * size


@compiled
def correct_by_rotation(
    x: Vector, h: Axis, innovation: float, variance: float, room: Workspace
) -> None:
    """Take a scalar measurement that only the attitude error moves, by h (3,), into x (91,)."""
    gain = room[0]
    for i in range(N):
        gain[i] = x[P + N * i] * h[0] + x[P + N * i + 1] * h[1] + x[P + N * i + 2] * h[2]
    variance = variance + h[0] * gain[0] + h[1] * gain[1] + h[2] * gain[2]
    apply_correction(x, gain, innovation, variance)


@compiled
def correct_velocity(x: Vector, v_ned_mps: Vector, variance: float, room: Workspace) -> None:
    """Take a velocity over ground (3,), axis by axis."""
    gain = room[0]
    for axis in range(3):
        for i in range(N):
            # h picks one velocity out, so that P h is a column of P.
            gain[i] = x[P + N * i + D_VELOCITY + axis]
        innovation = v_ned_mps[axis] - x[VELOCITY + axis]
        apply_correction(x, gain, innovation, variance + gain[D_VELOCITY + axis])


@compiled
def restart_velocity(x: Vector, v_ned_mps: Vector, variance: float) -> None:
    """Take the velocity (3,) in m/s as measured into x (91,) and forget what it had to do with the
    other errors."""
    for i in range(D_VELOCITY, N):
        for j in range(N):
            set_symmetric(x, i, j, 0.0)
    for axis in range(3):
        x[VELOCITY + axis] = v_ned_mps[axis]
        set_symmetric(x, D_VELOCITY + axis, D_VELOCITY + axis, variance)


@compiled
def correct_heading(
    x: Vector, field: Vector, declination_rad: float, variance: float, room: Workspace
) -> None:
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
    innovation = wrap_angle(declination_rad - atan2(east, north))
    correct_by_rotation(x, h, innovation, variance, room)


@compiled
def correct_tilt(
    x: Vector, imu: Vector, speed_mps: float, variance: float, room: Workspace
) -> None:
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
            h, expected = (gz, 0.0, -gx), gy + (imu[2] - x[BIAS + 2]) * speed_mps
        else:
            h, expected = (-gy, gx, 0.0), gz - (imu[1] - x[BIAS + 1]) * speed_mps
        correct_by_rotation(x, h, imu[FORCE + axis] - expected, variance, room)


@compiled
def advance_to_sample(
    x: Vector,
    stamps: Stamps,
    t_us: int,
    imu: Vector,
    speed_mps: float,
    tuning: Tuning,
    room: Workspace,
) -> None:
    """Move the state to an IMU sample (6,), and its `stamps` with it."""
    dt_s = (t_us - stamps[STATE]) * 1e-6
    if dt_s <= 0.0:
        return
    # Over a longer gap the IMU tells nothing: the state waits for the other sensors.
    if dt_s <= MAX_GAP_S:
        predict(x, imu, dt_s, tuning, room)
    due = t_us - stamps[TILT] >= 1e6 * tuning.gravity_period_s
    if due and t_us - stamps[GPS] >= 1e6 * tuning.gps_timeout_s:
        correct_tilt(x, imu, speed_mps, tuning.gravity_variance, room)
        stamps[TILT] = t_us
    stamps[STATE] = t_us


@compiled
def correct_from_fix(
    x: Vector, stamps: Stamps, t_us: int, fix: Vector, tuning: Tuning, room: Workspace
) -> None:
    """Take the numbers (11,) of a fix; one that does not tell the climb is no use."""
    v_ned_mps = fix[FIX_VELOCITY:FIX_TYPE]
    if fix[FIX_TYPE] < MIN_FIX or not np.isfinite(v_ned_mps).all():
        return
    if t_us - stamps[GPS] >= 1e6 * tuning.gps_timeout_s:
        restart_velocity(x, v_ned_mps, tuning.velocity_variance)
    else:
        correct_velocity(x, v_ned_mps, tuning.velocity_variance, room)
    # Fixes may come out of order; the silence counts from the newest.
    stamps[GPS] = max(t_us, stamps[GPS])


@compiled
def filter_block(
    kind: Indices,
    t_us: Stamps,
    values: Vector,
    x: Vector,
    stamps: Stamps,
    speed_mps: float,
    declination_rad: float,
    tuning: Tuning,
) -> tuple[Stamps, Vector, Vector, Stamps, float]:
    """The filter over a block (see `analysis.samples.block`).

    Parameters
    ----------
    kind, t_us, values : (n,), (n,), (n, WIDTH)
    x, stamps, speed_mps : (91,), (3,)
        The state before.

    Returns
    -------
    Stamps (m,) and q_nb (m, 4) after each IMU sample, and the state after.
    """
    when, q_nb = empty_estimates(kind)
    x, stamps, room = x.copy(), stamps.copy(), new_workspace()
    done = 0
    for i in range(len(kind)):
        if kind[i] == IMU:
            advance_to_sample(x, stamps, t_us[i], values[i], speed_mps, tuning, room)
            when[done] = stamps[STATE]
            for k in range(4):
                q_nb[done, k] = x[k]
            done += 1
        elif kind[i] == MAG:
            correct_heading(x, values[i], declination_rad, tuning.heading_variance, room)
        elif kind[i] == FIX:
            correct_from_fix(x, stamps, t_us[i], values[i], tuning, room)
        elif kind[i] == AIRSPEED:
            speed_mps = airspeed_mps(values[i, 0])
    return when, q_nb, x, stamps, speed_mps
