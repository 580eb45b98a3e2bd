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

from analysis.fdi.linear import add_product, apply, inverse, multiply, transposed
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

X_SIZE = 21
ERRORS = 20
R, V, PSI, BG, BA, CLOCK, DRIFT, ISB = 0, 3, 6, 9, 12, 15, 16, 17
X_Q, X_BG, X_BA, X_CLOCK, X_DRIFT, X_ISB = 6, 10, 13, 16, 17, 18


@compiled
def gravity_ecef(r: Vector) -> Vector:
    """Gravity (3,) in ECEF: mass attraction with J2, and the centrifugal part (WGS 84)."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    size = math.sqrt(square)
    out = np.zeros(3)
    if size < 1.0e6:
        return out
    factor = -3.986004418e14 / (square * size)
    bulge = 1.5 * 1.082627e-3 * 6378137.0 * 6378137.0 / square
    tilt = 5.0 * r[2] * r[2] / square
    spin = 7.2921151467e-5 * 7.2921151467e-5
    out[0] = (factor * (1.0 + bulge * (1.0 - tilt)) + spin) * r[0]
    out[1] = (factor * (1.0 + bulge * (1.0 - tilt)) + spin) * r[1]
    out[2] = factor * (1.0 + bulge * (3.0 - tilt)) * r[2]
    return out


@compiled
def matrix(q: Vector) -> Vector:
    """Rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out = np.empty((3, 3))
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1] = 2.0 * (x * y - w * z)
    out[0, 2] = 2.0 * (x * z + w * y)
    out[1, 0] = 2.0 * (x * y + w * z)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 2] = 2.0 * (y * z - w * x)
    out[2, 0] = 2.0 * (x * z - w * y)
    out[2, 1] = 2.0 * (y * z + w * x)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return out


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
def _mechanise(x: Vector, gyro: Vector, accel: Vector, dt: float) -> tuple[Vector, Vector]:
    """Advance x in place; returns the rotation and the specific force in ECEF at mid-step."""
    earth = 7.2921151467e-5
    rate = np.empty(3)
    c = matrix(x[6:10])
    for i in range(3):
        rate[i] = (gyro[i] - x[10 + i] - earth * c[2, i]) * dt
    half = np.empty(3)
    for i in range(3):
        half[i] = 0.5 * rate[i]
    mid = matrix(turned(x[6:10], half, -1.0))
    f = np.empty(3)
    for i in range(3):
        f[i] = 0.0
        for j in range(3):
            f[i] += mid[i, j] * (accel[j] - x[13 + j])
    g = gravity_ecef(x[0:3])
    vx, vy = x[3], x[4]
    step = np.empty(3)
    step[0] = (f[0] + g[0] + 2.0 * earth * vy) * dt
    step[1] = (f[1] + g[1] - 2.0 * earth * vx) * dt
    step[2] = (f[2] + g[2]) * dt
    for i in range(3):
        x[i] += (x[3 + i] + 0.5 * step[i]) * dt
        x[3 + i] += step[i]
    q = turned(x[6:10], rate, -1.0)
    for i in range(4):
        x[6 + i] = q[i]
    return mid, f


@compiled
def _transition(p: Vector, c: Vector, f: Vector, dt: float) -> None:
    """Multiply p (20, k) from the left by the transition of one step, in place."""
    earth = 7.2921151467e-5 * dt
    fx, fy, fz = f[0] * dt, f[1] * dt, f[2] * dt
    for j in range(p.shape[1]):
        vx, vy = p[3, j], p[4, j]
        tx, ty, tz = p[6, j], p[7, j], p[8, j]
        p[0, j] += dt * p[3, j]
        p[1, j] += dt * p[4, j]
        p[2, j] += dt * p[5, j]
        a0, a1, a2 = p[12, j] * dt, p[13, j] * dt, p[14, j] * dt
        g0, g1, g2 = p[9, j] * dt, p[10, j] * dt, p[11, j] * dt
        p[3, j] += fz * ty - fy * tz - (c[0, 0] * a0 + c[0, 1] * a1 + c[0, 2] * a2)
        p[4, j] += fx * tz - fz * tx - (c[1, 0] * a0 + c[1, 1] * a1 + c[1, 2] * a2)
        p[5, j] += fy * tx - fx * ty - (c[2, 0] * a0 + c[2, 1] * a1 + c[2, 2] * a2)
        p[3, j] += 2.0 * earth * vy
        p[4, j] -= 2.0 * earth * vx
        p[6, j] += earth * ty - (c[0, 0] * g0 + c[0, 1] * g1 + c[0, 2] * g2)
        p[7, j] -= earth * tx + (c[1, 0] * g0 + c[1, 1] * g1 + c[1, 2] * g2)
        p[8, j] -= c[2, 0] * g0 + c[2, 1] * g1 + c[2, 2] * g2
        p[15, j] += dt * p[16, j]


@compiled
def _add_noise(p: Vector, noise: Vector, dt: float) -> None:
    for i in range(3):
        p[3 + i, 3 + i] += noise[1] * dt
        p[6 + i, 6 + i] += noise[0] * dt
        p[9 + i, 9 + i] += noise[2] * dt
        p[12 + i, 12 + i] += noise[3] * dt
    p[15, 15] += noise[4] * dt + noise[5] * dt * dt * dt / 3.0
    p[15, 16] += noise[5] * dt * dt / 2.0
    p[16, 15] += noise[5] * dt * dt / 2.0
    p[16, 16] += noise[5] * dt
    for i in range(17, 20):
        p[i, i] += noise[6] * dt


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
    x, p = x.copy(), p.copy()
    phi = np.eye(20)
    for k in range(samples.shape[0]):
        dt = samples[k, 0]
        if dt <= 0.0:
            continue
        c, f = _mechanise(x, samples[k, 1:4], samples[k, 4:7], dt)
        _transition(p, c, f, dt)
        p = transposed(p)
        _transition(p, c, f, dt)
        _transition(phi, c, f, dt)
        _add_noise(p, noise, dt)
        x[16] += x[17] * dt
    return x, p, phi


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
    _add_noise(p, quiet, dt)
    q = noise[7]
    for i in range(3):
        p[i, i] += q * dt * dt * dt / 3.0
        p[i, 3 + i] += q * dt * dt / 2.0
        p[3 + i, i] += q * dt * dt / 2.0
        p[3 + i, 3 + i] += q * dt
    return x, p, phi


@compiled
def innovate(
    p: Vector, h: Vector, variance: Vector, v: Vector
) -> tuple[Vector, Vector, Vector, float]:
    """P H' (20, n), M = inv(H P H' + diag(variance)) (n, n), u = M v (n,) and q = v' M v."""
    hp = multiply(h, p)
    ph = transposed(hp)
    s = multiply(h, ph)
    for i in range(variance.shape[0]):
        s[i, i] += variance[i]
    m = inverse(s)
    u = apply(m, v)
    q = 0.0
    for i in range(v.shape[0]):
        q += v[i] * u[i]
    return ph, m, u, q


@compiled
def correct(
    x: Vector, p: Vector, h: Vector, variance: Vector, ph: Vector, m: Vector, u: Vector
) -> tuple[Vector, Vector, Vector]:
    """State, covariance and the gain K = P H' M (20, n) after what `innovate` gave.

    The covariance in Joseph's form, (I - K H) P (I - K H)' + K R K', stays positive definite when a
    part of the state was forgotten. With T = (I - K H) P it is T - (T H' - K R) K'.
    """
    d = apply(ph, u)
    x = x.copy()
    turn = np.empty(3)
    for i in range(3):
        turn[i] = d[6 + i]
    q = turned(x[6:10], turn, 1.0)
    for i in range(6):
        x[i] += d[i]
    for i in range(4):
        x[6 + i] = q[i]
    for i in range(9, d.shape[0]):
        x[1 + i] += d[i]
    gain = multiply(ph, m)
    hp = transposed(ph)
    left = p.copy()
    add_product(left, -1.0, gain, hp)
    rest = multiply(h, transposed(left))  # (T H')'
    for i in range(rest.shape[0]):
        for j in range(rest.shape[1]):
            rest[i, j] -= gain[j, i] * variance[i]
    back = transposed(left)  # T is not symmetric: T' - K (T H' - K R)'
    add_product(back, -1.0, gain, rest)
    after = np.empty_like(p)
    for i in range(p.shape[0]):
        for j in range(p.shape[0]):
            after[i, j] = 0.5 * (back[i, j] + back[j, i])
    return x, after, gain
