"""The arithmetic of the quaternion EKF, compiled; see `ekf` for the layout of x (91,).

Plain loops, no slices: assignments of slices cost seconds of compilation.
"""

import numpy as np
from numpy.typing import NDArray

from analysis.block import AIRSPEED, FIX, IMU, MAG, Indices, Stamps
from analysis.estimators.base import GRAVITY_MPS2, MAX_GAP_S, airspeed_mps, room_for_estimates
from analysis.estimators.rotations import heading_error, matrix, turned
from mavproxy_fault.wire.compiled import compiled

Vector = NDArray[np.float64]
N = 9  # error states: turn, bias, velocity
MIN_FIX = 3  # GPS_FIX_TYPE_3D_FIX
NOW, GPS, TILT = 0, 1, 2  # stamps: of the state, of the newest velocity, of gravity's last use


@compiled
def predict(
    x: Vector,
    gyro: Vector,
    accel: Vector,
    dt_s: float,
    gyro_density: float,
    bias_density: float,
    accel_density: float,
) -> Vector:
    """State and covariance after one IMU sample (gyro, accel (3,)).

    The turn's error obeys t' = -omega x t - b, the velocity's v' = -rot (f x t).
    """
    out = np.empty(91)
    rx, ry, rz = gyro[0] - x[4], gyro[1] - x[5], gyro[2] - x[6]
    q = turned(x[:4], 0.5 * rx * dt_s, 0.5 * ry * dt_s, 0.5 * rz * dt_s)  # at mid-step
    rot = matrix(q)
    q = turned(q, 0.5 * rx * dt_s, 0.5 * ry * dt_s, 0.5 * rz * dt_s)
    for i in range(4):
        out[i] = q[i]
    fx, fy, fz = accel[0], accel[1], accel[2]
    for i in range(3):
        out[4 + i] = x[4 + i]
        out[7 + i] = x[7 + i] + dt_s * (rot[i, 0] * fx + rot[i, 1] * fy + rot[i, 2] * fz)
    out[9] += dt_s * GRAVITY_MPS2
    moves = np.empty((6, 3))  # what the turn's error does to itself, and to the velocity's
    moves[0, 0], moves[0, 1], moves[0, 2] = 1.0, dt_s * rz, -dt_s * ry
    moves[1, 0], moves[1, 1], moves[1, 2] = -dt_s * rz, 1.0, dt_s * rx
    moves[2, 0], moves[2, 1], moves[2, 2] = dt_s * ry, -dt_s * rx, 1.0
    for i in range(3):
        moves[3 + i, 0] = -dt_s * (rot[i, 1] * fz - rot[i, 2] * fy)
        moves[3 + i, 1] = -dt_s * (rot[i, 2] * fx - rot[i, 0] * fz)
        moves[3 + i, 2] = -dt_s * (rot[i, 0] * fy - rot[i, 1] * fx)
    spread(out, x, moves, dt_s)
    for i in range(3):
        out[10 + (N + 1) * i] += dt_s * gyro_density * gyro_density
        out[10 + (N + 1) * (i + 3)] += dt_s * bias_density * bias_density
        out[10 + (N + 1) * (i + 6)] += dt_s * accel_density * accel_density
    return out


@compiled
def spread(out: Vector, x: Vector, moves: NDArray[np.float64], dt_s: float) -> None:
    """Write F P F', made symmetric, into the tail of the new state `out`.

    F is the identity, but for the turn's columns, `moves` (6, 3) in the rows of turn and velocity,
    and for what the bias does to the turn in `dt_s`.
    """
    before = x[10:].reshape(N, N)
    half = np.empty((N, N))  # F P
    for j in range(N):
        for i in range(3):
            turn = moves[i, 0] * before[0, j] + moves[i, 1] * before[1, j]
            half[i, j] = turn + moves[i, 2] * before[2, j] - dt_s * before[3 + i, j]
            half[3 + i, j] = before[3 + i, j]
            turn = moves[3 + i, 0] * before[0, j] + moves[3 + i, 1] * before[1, j]
            half[6 + i, j] = turn + moves[3 + i, 2] * before[2, j] + before[6 + i, j]
    for i in range(N):
        for j in range(i, N):
            if 3 <= j < 6:
                total = half[i, j]
            else:
                row = j if j < 3 else j - 3
                turn = half[i, 0] * moves[row, 0] + half[i, 1] * moves[row, 1]
                turn += half[i, 2] * moves[row, 2]
                total = turn - dt_s * half[i, 3 + j] if j < 3 else turn + half[i, j]
            out[10 + N * i + j] = total
            out[10 + N * j + i] = total


@compiled
def correct(x: Vector, row: Vector, innovation: float, variance: float) -> Vector:
    """One scalar measurement with sensitivity row (9,) to the error states."""
    out = x.copy()
    p = out[10:].reshape(N, N)
    gain = np.zeros(N)
    scale = variance
    for i in range(N):
        for j in range(N):
            gain[i] += p[i, j] * row[j]
    for i in range(N):
        scale += row[i] * gain[i]
    for i in range(N):
        for j in range(i, N):
            p[i, j] -= gain[i] * gain[j] / scale
            p[j, i] = p[i, j]
    size = innovation / scale
    q = turned(x[:4], gain[0] * size, gain[1] * size, gain[2] * size)
    for i in range(4):
        out[i] = q[i]
    for i in range(6):
        out[4 + i] += gain[3 + i] * size
    return out


@compiled
def correct_velocity(x: Vector, v_ned_mps: Vector, variance: float) -> Vector:
    """Velocity over ground (3,), axis by axis."""
    for axis in range(3):
        row = np.zeros(N)
        row[6 + axis] = 1.0
        x = correct(x, row, v_ned_mps[axis] - x[7 + axis], variance)
    return x


@compiled
def restart_velocity(x: Vector, v_ned_mps: Vector, variance: float) -> Vector:
    """Take the velocity as measured and forget what it had to do with the other errors."""
    out = x.copy()
    p = out[10:].reshape(N, N)
    for i in range(6, N):
        for j in range(N):
            p[i, j] = 0.0
            p[j, i] = 0.0
    for axis in range(3):
        out[7 + axis] = v_ned_mps[axis]
        p[6 + axis, 6 + axis] = variance
    return out


@compiled
def head(x: Vector, field: Vector, declination_rad: float, variance: float) -> Vector:
    """The heading of the field (3,): a small turn e in NED moves it by

    e_d - m_d (e_n m_n + e_e m_e) / (m_n^2 + m_e^2), so that a tilt is not taken for heading.
    """
    rot = matrix(x[:4])
    seen = np.zeros(3)
    for i in range(3):
        for j in range(3):
            seen[i] += rot[i, j] * field[j]
    tilt = -seen[2] / (seen[0] * seen[0] + seen[1] * seen[1] + 1e-12)
    row = np.zeros(N)
    for j in range(3):
        row[j] = rot[2, j] + tilt * (seen[0] * rot[0, j] + seen[1] * rot[1, j])
    return correct(x, row, heading_error(x[:4], field, declination_rad), variance)


@compiled
def level(x: Vector, gyro: Vector, accel: Vector, speed_mps: float, variance: float) -> Vector:
    """Specific force (3,) as gravity plus the centripetal part of a flight along the nose.

    The error of the turn moves gravity in body axes by g x t.
    """
    for axis in range(3):
        down = matrix(x[:4])[2]
        gx, gy, gz = -GRAVITY_MPS2 * down[0], -GRAVITY_MPS2 * down[1], -GRAVITY_MPS2 * down[2]
        row = np.zeros(N)
        if axis == 0:
            row[1], row[2] = -gz, gy
            expected = gx
        elif axis == 1:
            row[0], row[2] = gz, -gx
            expected = gy + (gyro[2] - x[6]) * speed_mps
        else:
            row[0], row[1] = -gy, gx
            expected = gz - (gyro[1] - x[5]) * speed_mps
        x = correct(x, row, accel[axis] - expected, variance)
    return x


@compiled
def moved(
    x: Vector, stamps: Stamps, t_us: int, v: Vector, speed_mps: float, numbers: Vector
) -> Vector:
    """The state after the numbers v (7,) of an IMU sample; `stamps` are moved on."""
    dt_s = (t_us - stamps[NOW]) * 1e-6
    if dt_s <= 0.0:
        return x
    if dt_s <= MAX_GAP_S:
        x = predict(x, v[0:3], v[3:6], dt_s, numbers[0], numbers[1], numbers[2])
    if t_us - stamps[GPS] >= numbers[7] and t_us - stamps[TILT] >= numbers[6]:
        x = level(x, v[0:3], v[3:6], speed_mps, numbers[5])
        stamps[TILT] = t_us
    stamps[NOW] = t_us
    return x


@compiled
def with_velocity(x: Vector, stamps: Stamps, t_us: int, v: Vector, numbers: Vector) -> Vector:
    """The state after the numbers v (11,) of a fix; one that does not tell the climb is no use."""
    finite = np.isfinite(v[3]) and np.isfinite(v[4]) and np.isfinite(v[5])
    if v[6] < MIN_FIX or not finite:
        return x
    if t_us - stamps[GPS] >= numbers[7]:
        x = restart_velocity(x, v[3:6], numbers[3])
    else:
        x = correct_velocity(x, v[3:6], numbers[3])
    stamps[GPS] = max(t_us, stamps[GPS])
    return x


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
    """The filter over a block (see `analysis.block`).

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
    stamps = stamps.copy()
    done = 0
    for i in range(len(kind)):
        if kind[i] == IMU:
            x = moved(x, stamps, t_us[i], values[i], speed_mps, numbers)
            when[done] = stamps[NOW]
            for k in range(4):
                q_nb[done, k] = x[k]
            done += 1
        elif kind[i] == MAG:
            x = head(x, values[i, 0:3], declination_rad, numbers[4])
        elif kind[i] == FIX:
            x = with_velocity(x, stamps, t_us[i], values[i], numbers)
        elif kind[i] == AIRSPEED:
            speed_mps = airspeed_mps(values[i, 0])
    return when, q_nb, x, stamps, speed_mps
