"""The navigation state between epochs: strapdown mechanisation in ECEF and its error covariance.

State x (21,): position r (m), velocity v (m/s), quaternion q_eb (body to ECEF), gyro bias (rad/s),
accelerometer bias (m/s^2), receiver clock (m), its drift (m/s), offsets of Galileo, GLONASS and
BeiDou (m). Error (20,): dr, dv, psi, dbg, dba, dc, dd, di (3) with the true attitude
exp([psi]x) C_eb. Then [1]_

    dr' = dv
    dv' = -[f_e]x psi - C dba - 2 Omega x dv
    psi' = -C dbg - Omega x psi
    dc' = dd

with white noise on psi', dv', and random walks of the biases, clock, drift and offsets. The
gradient of gravity is left out: it matters over minutes without GNSS only.

References
----------
.. [1] P. D. Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation Systems,
   2nd ed., 2013, sections 5.3 and 14.2.3.
"""

import math

import numpy as np

from analysis.fdi.linear import multiply, transposed
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

X_SIZE = 21
ERRORS = 20
R, V, PSI, BG, BA, CLOCK, DRIFT, ISB = 0, 3, 6, 9, 12, 15, 16, 17
X_Q, X_BG, X_BA, X_CLOCK, X_DRIFT, X_ISB = 6, 10, 13, 16, 17, 18


@compiled
def gravity_ecef(r: Vector) -> Vector:
    """Gravity (3,) in ECEF: mass attraction with J2, and the centrifugal part (WGS 84)."""
    out = np.empty(3)
    out[0], out[1], out[2] = _gravity(r[0], r[1], r[2])
    return out


@compiled
def _gravity(x: float, y: float, z: float) -> tuple[float, float, float]:
    """The same by components, which needs no memory."""
    square = x * x + y * y + z * z
    size = math.sqrt(square)
    if size < 1.0e6:
        return 0.0, 0.0, 0.0
    factor = -3.986004418e14 / (square * size)
    bulge = 1.5 * 1.082627e-3 * 6378137.0 * 6378137.0 / square
    tilt = 5.0 * z * z / square
    spin = 7.2921151467e-5 * 7.2921151467e-5
    level = factor * (1.0 + bulge * (1.0 - tilt)) + spin
    return level * x, level * y, factor * (1.0 + bulge * (3.0 - tilt)) * z


@compiled
def turned(q: Vector, rotvec: Vector, sign: float) -> Vector:
    """q followed (sign 1) or preceded (-1) by the turn of a rotation vector (3,), normalised."""
    angle = math.sqrt(rotvec[0] * rotvec[0] + rotvec[1] * rotvec[1] + rotvec[2] * rotvec[2])
    scale = 0.5 if angle < 1e-8 else math.sin(0.5 * angle) / angle
    w, x, y, z = math.cos(0.5 * angle), scale * rotvec[0], scale * rotvec[1], scale * rotvec[2]
    out = np.empty(4)
    out[0] = w * q[0] - x * q[1] - y * q[2] - z * q[3]
    out[1] = w * q[1] + x * q[0] + sign * (y * q[3] - z * q[2])
    out[2] = w * q[2] + y * q[0] + sign * (z * q[1] - x * q[3])
    out[3] = w * q[3] + z * q[0] + sign * (x * q[2] - y * q[1])
    size = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
    for i in range(4):
        out[i] /= size
    return out


@compiled
def _mechanise(x: Vector, sample: Vector, c: Vector, f: Vector) -> None:
    """Advance x in place by one sample; c (9,) becomes the rotation, row by row, and f (3,) the
    specific force in ECEF at mid-step."""
    earth, dt = 7.2921151467e-5, sample[0]
    _turn(x, sample, c)
    ax, ay, az = sample[4] - x[13], sample[5] - x[14], sample[6] - x[15]
    f[0] = c[0] * ax + c[1] * ay + c[2] * az
    f[1] = c[3] * ax + c[4] * ay + c[5] * az
    f[2] = c[6] * ax + c[7] * ay + c[8] * az
    gx, gy, gz = _gravity(x[0], x[1], x[2])
    vx, vy, vz = x[3], x[4], x[5]
    sx = (f[0] + gx + 2.0 * earth * vy) * dt
    sy = (f[1] + gy - 2.0 * earth * vx) * dt
    sz = (f[2] + gz) * dt
    x[0] += (vx + 0.5 * sx) * dt
    x[1] += (vy + 0.5 * sy) * dt
    x[2] += (vz + 0.5 * sz) * dt
    x[3], x[4], x[5] = vx + sx, vy + sy, vz + sz
    x[16] += x[17] * dt


@compiled
def _turn(x: Vector, sample: Vector, c: Vector) -> None:
    """Turn the attitude in x by the rates of a sample; c (9,) becomes the rotation at mid-step."""
    earth, dt = 7.2921151467e-5, sample[0]
    w, i, j, k = x[6], x[7], x[8], x[9]
    rx = (sample[1] - x[10] - earth * 2.0 * (i * k - w * j)) * dt
    ry = (sample[2] - x[11] - earth * 2.0 * (j * k + w * i)) * dt
    rz = (sample[3] - x[12] - earth * (1.0 - 2.0 * (i * i + j * j))) * dt
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    scale = 0.25 if angle < 1e-8 else math.sin(0.25 * angle) / angle
    a, b, d, e = math.cos(0.25 * angle), scale * rx, scale * ry, scale * rz
    for half in range(2):  # the same turn to mid-step and to the end
        w, i, j, k = (
            a * w - b * i - d * j - e * k,
            a * i + b * w - d * k + e * j,
            a * j + d * w - e * i + b * k,
            a * k + e * w - b * j + d * i,
        )
        if half == 0:
            c[0], c[1], c[2] = (
                1.0 - 2.0 * (j * j + k * k),
                2.0 * (i * j - w * k),
                2.0 * (i * k + w * j),
            )
            c[3], c[4], c[5] = (
                2.0 * (i * j + w * k),
                1.0 - 2.0 * (i * i + k * k),
                2.0 * (j * k - w * i),
            )
            c[6], c[7], c[8] = (
                2.0 * (i * k - w * j),
                2.0 * (j * k + w * i),
                1.0 - 2.0 * (i * i + j * j),
            )
    size = math.sqrt(w * w + i * i + j * j + k * k)
    x[6], x[7], x[8], x[9] = w / size, i / size, j / size, k / size


@compiled
def _transition(p: Vector, c: Vector, f: Vector, dt: float, first: int, last: int) -> None:
    """Multiply the columns `first` to `last` of p, rows of 20 one after the other in (400,), from
    the left by the transition of one step, in place.

    The rows' distance is a number known when this is compiled: so it becomes vector instructions.
    """
    earth = 7.2921151467e-5 * dt
    fx, fy, fz = f[0] * dt, f[1] * dt, f[2] * dt
    c0, c1, c2, c3, c4 = c[0] * dt, c[1] * dt, c[2] * dt, c[3] * dt, c[4] * dt
    c5, c6, c7, c8 = c[5] * dt, c[6] * dt, c[7] * dt, c[8] * dt
    for j in range(first, last):
        vx, vy, vz = p[60 + j], p[80 + j], p[100 + j]
        tx, ty, tz = p[120 + j], p[140 + j], p[160 + j]
        gx, gy, gz = p[180 + j], p[200 + j], p[220 + j]
        ax, ay, az = p[240 + j], p[260 + j], p[280 + j]
        p[j] += dt * vx
        p[20 + j] += dt * vy
        p[40 + j] += dt * vz
        p[60 + j] = vx + fz * ty - fy * tz - (c0 * ax + c1 * ay + c2 * az) + 2.0 * earth * vy
        p[80 + j] = vy + fx * tz - fz * tx - (c3 * ax + c4 * ay + c5 * az) - 2.0 * earth * vx
        p[100 + j] = vz + fy * tx - fx * ty - (c6 * ax + c7 * ay + c8 * az)
        p[120 + j] = tx + earth * ty - (c0 * gx + c1 * gy + c2 * gz)
        p[140 + j] = ty - earth * tx - (c3 * gx + c4 * gy + c5 * gz)
        p[160 + j] = tz - (c6 * gx + c7 * gy + c8 * gz)
        p[300 + j] += dt * p[320 + j]


@compiled
def _transition_right(p: Vector, c: Vector, f: Vector, dt: float) -> None:
    """The same from the right, with the transposed transition, on what `_transition` has left of a
    symmetric p: what its rows 9 to 19 become is their columns' already."""
    earth = 7.2921151467e-5 * dt
    fx, fy, fz = f[0] * dt, f[1] * dt, f[2] * dt
    c0, c1, c2, c3, c4 = c[0] * dt, c[1] * dt, c[2] * dt, c[3] * dt, c[4] * dt
    c5, c6, c7, c8 = c[5] * dt, c[6] * dt, c[7] * dt, c[8] * dt
    for b in (0, 20, 40, 60, 80, 100, 120, 140, 160, 300):
        vx, vy, vz = p[b + 3], p[b + 4], p[b + 5]
        tx, ty, tz = p[b + 6], p[b + 7], p[b + 8]
        gx, gy, gz = p[b + 9], p[b + 10], p[b + 11]
        ax, ay, az = p[b + 12], p[b + 13], p[b + 14]
        p[b] += dt * vx
        p[b + 1] += dt * vy
        p[b + 2] += dt * vz
        p[b + 3] = vx + fz * ty - fy * tz - (c0 * ax + c1 * ay + c2 * az) + 2.0 * earth * vy
        p[b + 4] = vy + fx * tz - fz * tx - (c3 * ax + c4 * ay + c5 * az) - 2.0 * earth * vx
        p[b + 5] = vz + fy * tx - fx * ty - (c6 * ax + c7 * ay + c8 * az)
        p[b + 6] = tx + earth * ty - (c0 * gx + c1 * gy + c2 * gz)
        p[b + 7] = ty - earth * tx - (c3 * gx + c4 * gy + c5 * gz)
        p[b + 8] = tz - (c6 * gx + c7 * gy + c8 * gz)
        p[b + 15] += dt * p[b + 16]
    for i in range(9):
        for j in range(9, 20):
            p[20 * j + i] = p[20 * i + j]
    for j in range(20):
        p[20 * j + 15] = p[300 + j]


@compiled
def _add_noise(p: Vector, noise: Vector, dt: float) -> None:
    """Add the process noise of one step to p (400,), in place."""
    for i in range(3):
        p[21 * (3 + i)] += noise[1] * dt
        p[21 * (6 + i)] += noise[0] * dt
        p[21 * (9 + i)] += noise[2] * dt
        p[21 * (12 + i)] += noise[3] * dt
    p[315] += noise[4] * dt + noise[5] * dt * dt * dt / 3.0
    p[316] += noise[5] * dt * dt / 2.0
    p[335] += noise[5] * dt * dt / 2.0
    p[336] += noise[5] * dt
    for i in range(17, 20):
        p[21 * i] += noise[6] * dt


@compiled
def propagate_inertial(
    x: Vector, p: Vector, samples: Vector, noise: Vector
) -> tuple[Vector, Vector, Vector]:
    """State and covariance over a run of IMU samples.

    Parameters
    ----------
    x, p : (21,) and (20, 20)
    samples : (k, 7), each the length of its step in s, rates (3) and specific force (3)
    noise : (8,), squared densities of `Noise`

    Returns
    -------
    x, p and the transition (20, 20) of the whole run; the arguments stay as they were.
    """
    x, p, phi = x.copy(), p.copy().reshape(400), np.eye(20).reshape(400)
    c, f = np.empty(9), np.empty(3)
    for k in range(samples.shape[0]):
        dt = samples[k, 0]
        if dt <= 0.0:
            continue
        _mechanise(x, samples[k], c, f)
        _transition(p, c, f, dt, 0, 20)
        _transition_right(p, c, f, dt)
        _transition(phi, c, f, dt, 3, 17)  # the others stay as they were
        _add_noise(p, noise, dt)
    return x, p.reshape(20, 20), phi.reshape(20, 20)


@compiled
def propagate_freely(
    x: Vector, p: Vector, dt: float, noise: Vector
) -> tuple[Vector, Vector, Vector]:
    """The same over `dt` seconds without an IMU: steady velocity with random acceleration."""
    x = x.copy()
    phi = np.eye(20)
    for i in range(3):
        phi[i, 3 + i] = dt
        x[i] += x[3 + i] * dt
    phi[15, 16] = dt
    x[16] += x[17] * dt
    p = multiply(multiply(phi, p), transposed(phi))
    quiet = noise.copy()
    quiet[0] = quiet[1] = 0.0
    _add_noise(p.reshape(400), quiet, dt)
    q = noise[7]
    for i in range(3):
        p[i, i] += q * dt * dt * dt / 3.0
        p[i, 3 + i] += q * dt * dt / 2.0
        p[3 + i, i] += q * dt * dt / 2.0
        p[3 + i, 3 + i] += q * dt
    return x, p, phi
