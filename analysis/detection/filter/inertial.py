"""The state between epochs: strapdown mechanisation in ECEF and its error covariance [1]_.

State x (21,): position r (m), velocity v (m/s), quaternion q_eb (body to ECEF), gyro bias (rad/s),
accelerometer bias (m/s^2), receiver clock (m), its drift (m/s), offsets of Galileo, GLONASS and
BeiDou (m). Error (20,): dr, dv, psi, dbg, dba, dc, dd, di (3) with the true attitude
exp([psi]x) C_eb. docs/fdi.md, "Filter", has the equations; the gradient of gravity is left out: it
matters over minutes without GNSS only.

References
----------
.. [1] P. D. Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation Systems,
   2nd ed., 2013, sections 5.3 and 14.2.3.
"""

import math
from functools import cache

import numpy as np

from analysis.detection.filter.filter_config import ProcessNoise
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import (
    GNSS_EARTH_RATE_RPS,
    WGS84_GM_M3PS2,
    WGS84_SEMI_MAJOR_M,
)

Three = tuple[float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]
# Numbers of the state, which has a quaternion, and of its error; then where their parts begin.
X_SIZE, ERROR_SIZE = 21, 20
# In the error: position, velocity, attitude, biases, clock, drift, the systems' offsets.
R, V, PSI, BG, BA, CLOCK, DRIFT, ISB = 0, 3, 6, 9, 12, 15, 16, 17
# In the state, where they differ.
X_Q, X_BG, X_BA, X_CLOCK, X_DRIFT, X_ISB = 6, 10, 13, 16, 17, 18
DT, GYRO, ACCEL, SAMPLE_COLUMNS = 0, 1, 4, 7  # columns of a sample, and how many
# One sigma of the biases of cheap MEMS sensors at power-on; the filter narrows them in flight.
GYRO_BIAS_SIGMA_RPS, ACCEL_BIAS_SIGMA_MPS2 = 0.02, 0.3
SPARSE_SAMPLE_S = 0.03  # in longer steps force and rates may have changed unmeasured


def set_unknown_attitude(p: Vector) -> None:
    """Set the variances of an unknown attitude and of the biases at power-on in p (20, 20)."""
    for at, sigma in ((PSI, 3.0), (BG, GYRO_BIAS_SIGMA_RPS), (BA, ACCEL_BIAS_SIGMA_MPS2)):
        p[range(at, at + 3), range(at, at + 3)] = sigma**2


def gravity_ecef(r: Vector) -> Vector:
    """Gravity (3,) in ECEF: mass attraction with J2, and the centrifugal part (WGS 84)."""
    return np.array(_gravity(*r.tolist()))


@compiled
def _gravity(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Gravity as in `gravity_ecef`, by components."""
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
def _mechanise(x: Vector, samples: Vector, row: int) -> tuple[Nine, Three]:
    """Advance x in place by the sample of a row; the rotation, row by row, and the specific force
    in ECEF at mid-step."""
    earth, dt = GNSS_EARTH_RATE_RPS, samples[row, DT]
    c = _rotate(x, samples, row)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = c
    ax = samples[row, ACCEL] - x[X_BA]
    ay = samples[row, ACCEL + 1] - x[X_BA + 1]
    az = samples[row, ACCEL + 2] - x[X_BA + 2]
    fx = c0 * ax + c1 * ay + c2 * az
    fy = c3 * ax + c4 * ay + c5 * az
    fz = c6 * ax + c7 * ay + c8 * az
    gx, gy, gz = _gravity(x[R], x[R + 1], x[R + 2])
    vx, vy, vz = x[V], x[V + 1], x[V + 2]
    # Coriolis by the velocity before the step: its change within one is of second order.
    sx = (fx + gx + 2.0 * earth * vy) * dt
    sy = (fy + gy - 2.0 * earth * vx) * dt
    sz = (fz + gz) * dt
    # The mean of both velocities moves the position.
    x[R] += (vx + 0.5 * sx) * dt
    x[R + 1] += (vy + 0.5 * sy) * dt
    x[R + 2] += (vz + 0.5 * sz) * dt
    x[V], x[V + 1], x[V + 2] = vx + sx, vy + sy, vz + sz
    x[X_CLOCK] += x[X_DRIFT] * dt
    return c, (fx, fy, fz)


@inlined
def _rotate(x: Vector, samples: Vector, row: int) -> Nine:
    """Rotate the attitude in x by the rates of a row; the rotation at mid-step, row by row."""
    earth, dt = GNSS_EARTH_RATE_RPS, samples[row, DT]
    rx = samples[row, GYRO] - x[X_BG]
    ry = samples[row, GYRO + 1] - x[X_BG + 1]
    rz = samples[row, GYRO + 2] - x[X_BG + 2]
    w, i, j, k = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    rx = (rx - earth * 2.0 * (i * k - w * j)) * dt
    ry = (ry - earth * 2.0 * (j * k + w * i)) * dt
    rz = (rz - earth * (1.0 - 2.0 * (i * i + j * j))) * dt
    a, scale = _quarter(rx * rx + ry * ry + rz * rz)
    b, d, e = scale * rx, scale * ry, scale * rz
    c = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    for half in range(2):  # the same rotation to mid-step and to the end
        w, i, j, k = (
            a * w - b * i - d * j - e * k,
            a * i + b * w - d * k + e * j,
            a * j + d * w - e * i + b * k,
            a * k + e * w - b * j + d * i,
        )
        if half == 0:
            c = (
                1.0 - 2.0 * (j * j + k * k),
                2.0 * (i * j - w * k),
                2.0 * (i * k + w * j),
                2.0 * (i * j + w * k),
                1.0 - 2.0 * (i * i + k * k),
                2.0 * (j * k - w * i),
                2.0 * (i * k - w * j),
                2.0 * (j * k + w * i),
                1.0 - 2.0 * (i * i + j * j),
            )
    # One over its norm, which is 1 but for rounding.
    length = 1.5 - 0.5 * (w * w + i * i + j * j + k * k)
    x[X_Q], x[X_Q + 1] = w * length, i * length
    x[X_Q + 2], x[X_Q + 3] = j * length, k * length
    return c


@compiled
def _quarter(square: float) -> tuple[float, float]:
    """cos(a / 4) and sin(a / 4) / a of a rotation by a, from its square; by series where it is
    small, to the last digit."""
    if square > 0.01:
        angle = math.sqrt(square)
        return math.cos(0.25 * angle), math.sin(0.25 * angle) / angle
    u = square / 16.0
    cosine = 1.0 - u / 2.0 * (1.0 - u / 12.0 * (1.0 - u / 30.0))
    return cosine, 0.25 * (1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0)))


@inlined
def _add_step(phi: Vector, c: Nine, f: Three, dt: float) -> None:
    """Append one step to the transition phi (400,), the rows of a (20, 20) matrix, in place.

    The IMU affects the rows of position, velocity and attitude, from the columns of velocity to
    those of the accelerometer's bias. The distance of rows is a constant, so that the compiler can
    vectorise.
    """
    earth = GNSS_EARTH_RATE_RPS * dt
    fx, fy, fz = f[0] * dt, f[1] * dt, f[2] * dt
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = c
    c0, c1, c2, c3, c4 = c0 * dt, c1 * dt, c2 * dt, c3 * dt, c4 * dt
    c5, c6, c7, c8 = c5 * dt, c6 * dt, c7 * dt, c8 * dt
    # In place by columns: every element of a column is read before one is written.
    for j in range(V, CLOCK):
        r, v, t = R * ERROR_SIZE + j, V * ERROR_SIZE + j, PSI * ERROR_SIZE + j
        g, a = BG * ERROR_SIZE + j, BA * ERROR_SIZE + j
        vx, vy, vz = phi[v], phi[v + ERROR_SIZE], phi[v + 2 * ERROR_SIZE]
        tx, ty, tz = phi[t], phi[t + ERROR_SIZE], phi[t + 2 * ERROR_SIZE]
        gx, gy, gz = phi[g], phi[g + ERROR_SIZE], phi[g + 2 * ERROR_SIZE]
        ax, ay, az = phi[a], phi[a + ERROR_SIZE], phi[a + 2 * ERROR_SIZE]
        phi[r] += dt * vx
        phi[r + ERROR_SIZE] += dt * vy
        phi[r + 2 * ERROR_SIZE] += dt * vz
        push_x, push_y = c0 * ax + c1 * ay + c2 * az, c3 * ax + c4 * ay + c5 * az
        phi[v] = vx + fz * ty - fy * tz - push_x + 2.0 * earth * vy
        phi[v + ERROR_SIZE] = vy + fx * tz - fz * tx - push_y - 2.0 * earth * vx
        phi[v + 2 * ERROR_SIZE] = vz + fy * tx - fx * ty - (c6 * ax + c7 * ay + c8 * az)
        phi[t] = tx + earth * ty - (c0 * gx + c1 * gy + c2 * gz)
        phi[t + ERROR_SIZE] = ty - earth * tx - (c3 * gx + c4 * gy + c5 * gz)
        phi[t + 2 * ERROR_SIZE] = tz - (c6 * gx + c7 * gy + c8 * gz)
    phi[CLOCK * ERROR_SIZE + DRIFT] += dt


@compiled
def _advance(x: Vector, phi: Vector, samples: Vector) -> None:
    """Advance x and the transition phi (400,) in place by the samples."""
    for row in range(samples.shape[0]):
        # Two samples with one stamp are one sample.
        dt = samples[row, DT]
        if dt > 0.0:
            c, f = _mechanise(x, samples, row)
            _add_step(phi, c, f, dt)


def propagate_inertial(
    x: Vector, p: Vector, samples: Vector, noise: ProcessNoise
) -> tuple[Vector, Vector, Vector]:
    """State and covariance over a run of IMU samples.

    State and transition advance by single samples, the covariance by the transition over all.

    Parameters
    ----------
    x, p : (21,) and (20, 20)
    samples : (k, 7), each the length of its step in s, rates (3) and specific force (3)
    noise : its densities

    Returns
    -------
    x, p and the transition (20, 20) of the whole run; the arguments stay as they were.
    """
    x, phi = x.copy(), np.eye(ERROR_SIZE)
    _advance(x, phi.reshape(-1), samples)
    p = _propagated(p, phi, noise, True)
    diagonal, (speed, turn) = np.einsum("ii->i", p), unmeasured_variances(samples)
    diagonal[V:PSI] += speed
    diagonal[PSI:BG] += turn
    return x, p, phi


def unmeasured_variances(samples: Vector) -> tuple[float, float]:
    """Variances of velocity and attitude by what happens between the samples (k, 7) of a slow
    IMU."""
    sparse = samples[:, DT] > SPARSE_SAMPLE_S
    if not sparse.any():
        return 0.0, 0.0
    # Between two samples force and rates may have been anything: the mean square of their change is
    # that of white noise twice, on each of three axes.
    square = np.diff(samples[:, GYRO:], axis=0, prepend=samples[:1, GYRO:]) ** 2
    scale = sparse * samples[:, DT] ** 2 / 6.0
    return float((scale @ square[:, 3:]).sum()), float((scale @ square[:, :3]).sum())


@cache
def _noise_rates(noise: ProcessNoise, inertial: bool) -> tuple[Vector, Vector]:
    """Process noise: the IMU's per second (20, 20), and all other by powers of the time, first to
    third (3, 20, 20), that of free motion included unless `inertial`."""
    imu, other, axes = np.zeros(ERROR_SIZE), np.zeros((3, ERROR_SIZE, ERROR_SIZE)), np.arange(3)
    imu[V:PSI], imu[PSI:BG] = noise.accel_mps2**2, noise.gyro_rps**2
    imu[BG:BA], imu[BA:CLOCK] = noise.gyro_walk**2, noise.accel_walk**2
    # White noise of the drift's rate, integrated twice, once and not at all.
    drift, motion = noise.drift_mps**2, noise.motion_mps2**2
    other[2, CLOCK, CLOCK] = drift / 3.0
    other[1, CLOCK, DRIFT] = other[1, DRIFT, CLOCK] = drift / 2.0
    other[0, CLOCK, CLOCK], other[0, DRIFT, DRIFT] = noise.clock_m**2, drift
    other[0, range(ISB, ERROR_SIZE), range(ISB, ERROR_SIZE)] = noise.isb_m**2
    if not inertial:
        # Random acceleration, integrated to position and velocity. The biases keep walking.
        other[2, R + axes, R + axes] = motion / 3.0
        other[1, R + axes, V + axes] = other[1, V + axes, R + axes] = motion / 2.0
        other[0, V + axes, V + axes] = motion
        imu[:BG] = 0.0
    return np.diag(imu), other


def _propagated(p: Vector, phi: Vector, noise: ProcessNoise, inertial: bool) -> Vector:
    """The covariance (20, 20) after the transition phi (20, 20): half of the IMU's noise comes
    before it and half after, which is exact but for the third power of the time."""
    imu, (first, second, third) = _noise_rates(noise, inertial)
    # The clock's own transition is the elapsed time, so `dt` need not be handed in.
    dt = phi.item(CLOCK, DRIFT)
    half = 0.5 * dt * imu
    p = phi @ (p + half) @ phi.T
    p = 0.5 * (p + p.T)  # symmetric to the last digit
    p += half + dt * (first + dt * (second + dt * third))
    return p


def propagate_freely(
    x: Vector, p: Vector, dt: float, noise: ProcessNoise
) -> tuple[Vector, Vector, Vector]:
    """State, covariance and transition over `dt` seconds without an IMU: steady velocity with
    random acceleration; shapes as for `propagate_inertial`."""
    x, phi = x.copy(), np.eye(ERROR_SIZE)
    phi[range(R, V), range(V, PSI)] = phi[CLOCK, DRIFT] = dt
    x[R:V] += x[V:PSI] * dt
    x[X_CLOCK] += x[X_DRIFT] * dt
    return x, _propagated(p, phi, noise, False), phi
