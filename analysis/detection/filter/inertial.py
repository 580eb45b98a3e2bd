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

from analysis.detection.detection_config import NoiseDensities
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import (
    GNSS_EARTH_RATE_RPS,
    WGS84_GM_M3PS2,
    WGS84_SEMI_MAJOR_M,
)
from mavproxy_fault.numerics.linear import multiply, transposed

X_SIZE = 21
ERRORS = 20
R, V, PSI, BG, BA, CLOCK, DRIFT, ISB = 0, 3, 6, 9, 12, 15, 16, 17
X_Q, X_BG, X_BA, X_CLOCK, X_DRIFT, X_ISB = 6, 10, 13, 16, 17, 18
TOGETHER_S = 0.25  # so much at most of the covariance's way at once


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
    # At the origin, where no fix is yet, gravity would be infinite.
    factor = -WGS84_GM_M3PS2 / (square * size) if size > 1.0e6 else 0.0
    # 1.082627e-3 is J2.
    bulge = 1.5 * 1.082627e-3 * WGS84_SEMI_MAJOR_M * WGS84_SEMI_MAJOR_M / square
    tilt = 5.0 * z * z / square
    spin = GNSS_EARTH_RATE_RPS * GNSS_EARTH_RATE_RPS if size > 1.0e6 else 0.0
    level = factor * (1.0 + bulge * (1.0 - tilt)) + spin
    return level * x, level * y, factor * (1.0 + bulge * (3.0 - tilt)) * z


@inlined
def _mechanise(x: Vector, samples: Vector, row: int, c: Vector, f: Vector) -> None:
    """Advance x in place by the sample of a row; c (9,) becomes the rotation, row by row, and f
    (3,) the specific force in ECEF at mid-step."""
    earth, dt = GNSS_EARTH_RATE_RPS, samples[row, 0]
    _rotate(x, samples, row, c)
    ax, ay, az = samples[row, 4] - x[13], samples[row, 5] - x[14], samples[row, 6] - x[15]
    f[0] = c[0] * ax + c[1] * ay + c[2] * az
    f[1] = c[3] * ax + c[4] * ay + c[5] * az
    f[2] = c[6] * ax + c[7] * ay + c[8] * az
    gx, gy, gz = _gravity(x[0], x[1], x[2])
    vx, vy, vz = x[3], x[4], x[5]
    # Coriolis by the velocity before the step: its change within one is of second order.
    sx = (f[0] + gx + 2.0 * earth * vy) * dt
    sy = (f[1] + gy - 2.0 * earth * vx) * dt
    sz = (f[2] + gz) * dt
    # The mean of both velocities moves the position.
    x[0] += (vx + 0.5 * sx) * dt
    x[1] += (vy + 0.5 * sy) * dt
    x[2] += (vz + 0.5 * sz) * dt
    x[3], x[4], x[5] = vx + sx, vy + sy, vz + sz
    x[16] += x[17] * dt


@inlined
def _rotate(x: Vector, samples: Vector, row: int, c: Vector) -> None:
    """Turn the attitude in x by the rates of a row; c (9,) becomes the rotation at mid-step."""
    earth, dt = GNSS_EARTH_RATE_RPS, samples[row, 0]
    rx, ry, rz = samples[row, 1] - x[10], samples[row, 2] - x[11], samples[row, 3] - x[12]
    w, i, j, k = x[6], x[7], x[8], x[9]
    rx = (rx - earth * 2.0 * (i * k - w * j)) * dt
    ry = (ry - earth * 2.0 * (j * k + w * i)) * dt
    rz = (rz - earth * (1.0 - 2.0 * (i * i + j * j))) * dt
    a, scale = _quarter(rx * rx + ry * ry + rz * rz)
    b, d, e = scale * rx, scale * ry, scale * rz
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
    length = 1.5 - 0.5 * (w * w + i * i + j * j + k * k)  # of a unit but for rounding, inverted
    x[6], x[7], x[8], x[9] = w * length, i * length, j * length, k * length


@compiled
def _quarter(square: float) -> tuple[float, float]:
    """cos(a / 4) and sin(a / 4) / a of a turn by a, from its square; by series where it is small,
    to the last digit."""
    if square > 0.01:
        angle = math.sqrt(square)
        return math.cos(0.25 * angle), math.sin(0.25 * angle) / angle
    u = square / 16.0
    cosine = 1.0 - u / 2.0 * (1.0 - u / 12.0 * (1.0 - u / 30.0))
    return cosine, 0.25 * (1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0)))


@inlined
def _add_step(phi: Vector, c: Vector, f: Vector, dt: float) -> None:
    """Put one step behind the transition phi, rows of 20 one after the other in (400,), in place.

    What depends on the IMU stands in its rows 0 to 8, columns 3 to 14. The rows'
    distance is a number known when this is compiled: so it becomes vector instructions.
    """
    earth = GNSS_EARTH_RATE_RPS * dt
    fx, fy, fz = f[0] * dt, f[1] * dt, f[2] * dt
    c0, c1, c2, c3, c4 = c[0] * dt, c[1] * dt, c[2] * dt, c[3] * dt, c[4] * dt
    c5, c6, c7, c8 = c[5] * dt, c[6] * dt, c[7] * dt, c[8] * dt
    # In place by columns: every element of a column is read before one is written.
    for j in range(3, 15):
        vx, vy, vz = phi[60 + j], phi[80 + j], phi[100 + j]
        tx, ty, tz = phi[120 + j], phi[140 + j], phi[160 + j]
        gx, gy, gz = phi[180 + j], phi[200 + j], phi[220 + j]
        ax, ay, az = phi[240 + j], phi[260 + j], phi[280 + j]
        phi[j] += dt * vx
        phi[20 + j] += dt * vy
        phi[40 + j] += dt * vz
        phi[60 + j] = vx + fz * ty - fy * tz - (c0 * ax + c1 * ay + c2 * az) + 2.0 * earth * vy
        phi[80 + j] = vy + fx * tz - fz * tx - (c3 * ax + c4 * ay + c5 * az) - 2.0 * earth * vx
        phi[100 + j] = vz + fy * tx - fx * ty - (c6 * ax + c7 * ay + c8 * az)
        phi[120 + j] = tx + earth * ty - (c0 * gx + c1 * gy + c2 * gz)
        phi[140 + j] = ty - earth * tx - (c3 * gx + c4 * gy + c5 * gz)
        phi[160 + j] = tz - (c6 * gx + c7 * gy + c8 * gz)
    # 316 is row CLOCK, column DRIFT.
    phi[316] += dt


@compiled
def _add_noise(p: Vector, noise: NoiseDensities, dt: float) -> None:
    """Add what the IMU's noise does in a while to p (400,), in place."""
    # 21 steps from one diagonal element of (20, 20) to the next.
    for i in range(3):
        p[21 * (V + i)] += noise.accel_mps2 * dt
        p[21 * (PSI + i)] += noise.gyro_rps * dt
    _add_walks(p, noise, dt)


@compiled
def _add_walks(p: Vector, noise: NoiseDensities, dt: float) -> None:
    """The same of its biases alone."""
    for i in range(3):
        p[21 * (BG + i)] += noise.gyro_walk * dt
        p[21 * (BA + i)] += noise.accel_walk * dt


@compiled
def _add_clock_noise(p: Vector, noise: NoiseDensities, dt: float) -> None:
    """The same of the clock and the offsets of systems."""
    # White noise of the drift's rate, integrated twice, once and not at all.
    p[315] += noise.clock_m * dt + noise.drift_mps * dt * dt * dt / 3.0
    p[316] += noise.drift_mps * dt * dt / 2.0
    p[335] += noise.drift_mps * dt * dt / 2.0
    p[336] += noise.drift_mps * dt
    for i in range(17, 20):
        p[21 * i] += noise.isb_m * dt


@compiled
def _carried(p: Vector, phi: Vector, noise: NoiseDensities) -> Vector:
    """The covariance (20, 20) after a while of the transition phi (20, 20): half of the IMU's noise
    comes before it and half after, which is exact but for the third power of the time."""
    # The clock's own transition is the elapsed time, so `dt` need not be handed in.
    dt, p = phi[CLOCK, DRIFT], p.copy()
    _add_noise(p.reshape(400), noise, 0.5 * dt)
    p = multiply(phi, transposed(multiply(phi, p)))
    # Rounding makes the product asymmetric, and Cholesky would amplify that.
    for i in range(20):
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
    _add_noise(p.reshape(400), noise, 0.5 * dt)
    _add_clock_noise(p.reshape(400), noise, dt)
    return p


@compiled
def propagate_inertial(
    x: Vector, p: Vector, samples: Vector, noise: NoiseDensities
) -> tuple[Vector, Vector, Vector]:
    """State and covariance over a run of IMU samples.

    State and transition go by single samples, the covariance by transitions over at most
    `TOGETHER_S`.

    Parameters
    ----------
    x, p : (21,) and (20, 20)
    samples : (k, 7), each the length of its step in s, rates (3) and specific force (3)
    noise : squared densities

    Returns
    -------
    x, p and the transition (20, 20) of the whole run; the arguments stay as they were.
    """
    x, whole = x.copy(), np.eye(20)
    row = 0
    while row < samples.shape[0]:
        phi = np.eye(20)
        first, row = row, _advance(x, phi.reshape(400), samples, row)
        p = _carried(p, phi, noise)
        whole = phi if first == 0 else multiply(phi, whole)
    return x, p, whole


@compiled
def _advance(x: Vector, phi: Vector, samples: Vector, row: int) -> int:
    """Advance x and the transition phi (400,) in place by the samples from a row on, over
    `TOGETHER_S` at most; returns the row after."""
    c, f, until_s = np.empty(9), np.empty(3), TOGETHER_S
    while row < samples.shape[0] and until_s > 0.0:
        # Two samples with one stamp are one sample.
        dt = samples[row, 0]
        if dt > 0.0:
            _mechanise(x, samples, row, c, f)
            _add_step(phi, c, f, dt)
            until_s -= dt
        row += 1
    return row


@compiled
def propagate_freely(
    x: Vector, p: Vector, dt: float, noise: NoiseDensities
) -> tuple[Vector, Vector, Vector]:
    """The same over `dt` seconds without an IMU: steady velocity with random acceleration; x (21,),
    p and the transition (20, 20)."""
    x = x.copy()
    phi = np.eye(20)
    for i in range(3):
        phi[i, 3 + i] = dt
        x[i] += x[3 + i] * dt
    phi[15, 16] = dt
    x[16] += x[17] * dt
    p = multiply(multiply(phi, p), transposed(phi))
    _add_walks(p.reshape(400), noise, dt)
    # Biases keep walking while the IMU is silent.
    _add_clock_noise(p.reshape(400), noise, dt)
    q = noise.motion_mps2
    for i in range(3):
        # Random acceleration, integrated to position and velocity.
        p[i, i] += q * dt * dt * dt / 3.0
        p[i, 3 + i] += q * dt * dt / 2.0
        p[3 + i, i] += q * dt * dt / 2.0
        p[3 + i, 3 + i] += q * dt
    return x, p, phi
