"""A quaternion EKF: attitude, gyro bias and velocity; nine error states.

The error state is a small rotation in body axes and the errors of bias and velocity [1]_. The IMU
drives the prediction; velocity over ground from GPS, compared with the integrated specific force,
observes the tilt in turning flight too, where gravity alone does not. The field observes the
heading. After `gps_timeout_s` without GPS velocity, the specific force less its centripetal part
serves as gravity.

Measurement updates change the state in place. The kernels have plain loops, no slices: slice
assignments cost seconds of compilation.

References
----------
.. [1] Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 5.
"""

from dataclasses import dataclass, field
from math import atan2
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.estimator import (
    MAX_GAP_S,
    KernelEstimator,
    KernelState,
    Prior,
    airspeed_mps,
    empty_estimates,
)
from analysis.samples.block import (
    AIRSPEED,
    FIX,
    FIX_3D,
    FIX_TYPE,
    FIX_VELOCITY,
    FORCE,
    IMU,
    MAG,
    Indices,
    Stamps,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    Axis,
    body_axes,
    quaternion_of_rotation,
    rotate_in_place,
    wrap_angle,
)

BIAS, VELOCITY, P = 4, 7, 10  # offsets in x, after the quaternion
N = 9  # error states: attitude, bias, velocity
D_BIAS, D_VELOCITY = 3, 6  # offsets in the error state
STATE, GPS, TILT = 0, 1, 2  # stamps: of the state, of the newest velocity, of gravity's last use

Workspace = NDArray[np.float64]  # (6, 12), for intermediate results; every sample reuses it
FP = 3  # column at which F P begins, after three columns of F


class Tuning(NamedTuple):
    """Noise densities and variances of the measurements; period of the gravity update, GPS timeout.

    The defaults suit a small vehicle's MEMS sensors with their vibration.
    """

    gyro_density: float = 2e-3  # rad/s/sqrt(Hz)
    bias_density: float = 2e-4  # rad/s^2/sqrt(Hz)
    accel_density: float = 0.05  # m/s^2/sqrt(Hz)
    velocity_variance: float = 0.2**2  # (m/s)^2
    heading_variance: float = 0.05**2  # rad^2
    gravity_variance: float = 1.0  # (m/s^2)^2
    gravity_period_s: float = 0.1
    gps_timeout_s: float = 2.0


@compiled
def predict(
    x: Vector,
    imu: Vector,
    dt_s: float,
    tuning: Tuning,
    work: Workspace,
) -> None:
    """Propagate state and covariance over one IMU sample, rates and specific force (6,).

    The attitude error obeys t' = -omega x t - b, the velocity's v' = -rot (f x t).
    """
    rx, ry, rz = imu[0] - x[BIAS], imu[1] - x[BIAS + 1], imu[2] - x[BIAS + 2]
    fx, fy, fz = imu[FORCE], imu[FORCE + 1], imu[FORCE + 2]
    # The force is rotated to NED by the attitude at mid-step: exact to second order.
    half_turn = quaternion_of_rotation(0.5 * rx * dt_s, 0.5 * ry * dt_s, 0.5 * rz * dt_s)
    rotate_in_place(x, half_turn)
    rows = body_axes(x)
    rotate_in_place(x, half_turn)
    for i in range(3):
        a, b, c = rows[i]
        x[VELOCITY + i] += dt_s * (a * fx + b * fy + c * fz)
        work[3 + i, 0] = -dt_s * (b * fz - c * fy)
        work[3 + i, 1] = -dt_s * (c * fx - a * fz)
        work[3 + i, 2] = -dt_s * (a * fy - b * fx)
    # The specific force of free fall is zero; down is positive.
    x[VELOCITY + 2] += dt_s * STANDARD_GRAVITY_MPS2
    work[0, 0], work[0, 1], work[0, 2] = 1.0, dt_s * rz, -dt_s * ry
    work[1, 0], work[1, 1], work[1, 2] = -dt_s * rz, 1.0, dt_s * rx
    work[2, 0], work[2, 1], work[2, 2] = dt_s * ry, -dt_s * rx, 1.0
    propagate_covariance(x, work, dt_s)
    for i in range(3):
        x[P + (N + 1) * i] += dt_s * tuning.gyro_density * tuning.gyro_density
        x[P + (N + 1) * (D_BIAS + i)] += dt_s * tuning.bias_density * tuning.bias_density
        x[P + (N + 1) * (D_VELOCITY + i)] += dt_s * tuning.accel_density * tuning.accel_density


@compiled
def propagate_covariance(x: Vector, work: Workspace, dt_s: float) -> None:
    """Replace P by F P F' in x (91,), in place.

    F is the identity except for the effect of the attitude error on attitude and velocity (the
    first three columns of `work`) and of the bias on the attitude over `dt_s`. The rows of F P
    that differ from those of P, attitude and velocity, are stored after these columns.
    """
    for j in range(N):
        attitude_0, attitude_1, attitude_2 = x[P + j], x[P + N + j], x[P + 2 * N + j]
        for i in range(3):
            sum_ = work[i, 0] * attitude_0 + work[i, 1] * attitude_1 + work[i, 2] * attitude_2
            work[i, FP + j] = sum_ - dt_s * x[P + N * (D_BIAS + i) + j]
            sum_ = (
                work[3 + i, 0] * attitude_0
                + work[3 + i, 1] * attitude_1
                + work[3 + i, 2] * attitude_2
            )
            work[3 + i, FP + j] = sum_ + x[P + N * (D_VELOCITY + i) + j]
    for i in range(3):
        for j in range(3):
            set_symmetric(x, i, D_BIAS + j, work[i, FP + D_BIAS + j])
            set_symmetric(x, D_BIAS + j, D_VELOCITY + i, work[3 + i, FP + D_BIAS + j])
            moved_velocity = attitude_product(work, i, 3 + j) + work[i, FP + D_VELOCITY + j]
            set_symmetric(x, i, D_VELOCITY + j, moved_velocity)
        for j in range(i, 3):
            set_symmetric(x, i, j, attitude_product(work, i, j) - dt_s * work[i, FP + D_BIAS + j])
            moved_velocity = attitude_product(work, 3 + i, 3 + j) + work[3 + i, FP + D_VELOCITY + j]
            set_symmetric(x, D_VELOCITY + i, D_VELOCITY + j, moved_velocity)


@inlined
def set_symmetric(x: Vector, i: int, j: int, value: float) -> None:
    """Set a covariance element in x (91,) and its symmetric counterpart."""
    x[P + N * i + j] = value
    x[P + N * j + i] = value


@inlined
def attitude_product(work: Workspace, i: int, j: int) -> float:
    """Row i of F P in `work` times row j of F, attitude columns only."""
    row, column = work[i], work[j]
    value: float = row[FP] * column[0] + row[FP + 1] * column[1] + row[FP + 2] * column[2]
    return value


@compiled
def apply_correction(x: Vector, gain: Vector, innovation: float, variance: float) -> None:
    """Apply one scalar measurement of innovation variance `variance`; `gain` (9,) is P h."""
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
    x: Vector, h: Axis, innovation: float, variance: float, work: Workspace
) -> None:
    """Apply a scalar measurement that depends on the attitude error only, by h (3,)."""
    gain = work[0]
    for i in range(N):
        gain[i] = x[P + N * i] * h[0] + x[P + N * i + 1] * h[1] + x[P + N * i + 2] * h[2]
    variance = variance + h[0] * gain[0] + h[1] * gain[1] + h[2] * gain[2]
    apply_correction(x, gain, innovation, variance)


@compiled
def correct_velocity(x: Vector, v_ned_mps: Vector, variance: float, work: Workspace) -> None:
    """Apply a velocity over ground (3,), axis by axis."""
    gain = work[0]
    for axis in range(3):
        for i in range(N):
            # h selects one velocity, so that P h is a column of P.
            gain[i] = x[P + N * i + D_VELOCITY + axis]
        innovation = v_ned_mps[axis] - x[VELOCITY + axis]
        apply_correction(x, gain, innovation, variance + gain[D_VELOCITY + axis])


@compiled
def restart_velocity(x: Vector, v_ned_mps: Vector, variance: float) -> None:
    """Set the velocity in x (91,) to the measurement (3,) in m/s and clear its correlation with the
    other errors."""
    for i in range(D_VELOCITY, N):
        for j in range(N):
            set_symmetric(x, i, j, 0.0)
    for axis in range(3):
        x[VELOCITY + axis] = v_ned_mps[axis]
        set_symmetric(x, D_VELOCITY + axis, D_VELOCITY + axis, variance)


@compiled
def correct_heading(
    x: Vector, field: Vector, declination_rad: float, variance: float, work: Workspace
) -> None:
    """Apply the heading of the field (3,): a small rotation e in NED changes it by

    e_d - m_d (e_n m_n + e_e m_e) / (m_n^2 + m_e^2), so that a tilt is not mistaken for heading.
    """
    fx, fy, fz = field[0], field[1], field[2]
    (n_x, n_y, n_z), (e_x, e_y, e_z), (d_x, d_y, d_z) = body_axes(x)
    north = n_x * fx + n_y * fy + n_z * fz
    east = e_x * fx + e_y * fy + e_z * fz
    # Over a magnetic pole the field has no heading: the small number keeps h finite.
    tilt = -(d_x * fx + d_y * fy + d_z * fz) / (north * north + east * east + 1e-12)
    h = (
        d_x + tilt * (north * n_x + east * e_x),
        d_y + tilt * (north * n_y + east * e_y),
        d_z + tilt * (north * n_z + east * e_z),
    )
    innovation = wrap_angle(declination_rad - atan2(east, north))
    correct_by_rotation(x, h, innovation, variance, work)


@compiled
def correct_tilt(
    x: Vector, imu: Vector, speed_mps: float, variance: float, work: Workspace
) -> None:
    """Apply the specific force of an IMU sample (6,) as gravity plus the centripetal part of flight
    along the nose, axis by axis.

    The attitude error changes gravity in body axes by g x t.
    """
    for axis in range(3):
        # Recomputed for each axis, since the last correction moved the attitude.
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
        correct_by_rotation(x, h, imu[FORCE + axis] - expected, variance, work)


@compiled
def advance_to_sample(
    x: Vector,
    stamps: Stamps,
    t_us: int,
    imu: Vector,
    speed_mps: float,
    tuning: Tuning,
    work: Workspace,
) -> None:
    """Propagate the state and its `stamps` to an IMU sample (6,)."""
    dt_s = (t_us - stamps[STATE]) * 1e-6
    if dt_s <= 0.0:
        return
    # A longer gap is not integrated; the other sensors correct the state afterwards.
    if dt_s <= MAX_GAP_S:
        predict(x, imu, dt_s, tuning, work)
    due = t_us - stamps[TILT] >= 1e6 * tuning.gravity_period_s
    if due and t_us - stamps[GPS] >= 1e6 * tuning.gps_timeout_s:
        correct_tilt(x, imu, speed_mps, tuning.gravity_variance, work)
        stamps[TILT] = t_us
    stamps[STATE] = t_us


@compiled
def correct_from_fix(
    x: Vector, stamps: Stamps, t_us: int, fix: Vector, tuning: Tuning, work: Workspace
) -> None:
    """Apply the velocity of a fix (11,); a fix without vertical velocity is ignored."""
    v_ned_mps = fix[FIX_VELOCITY:FIX_TYPE]
    if fix[FIX_TYPE] < FIX_3D or not np.isfinite(v_ned_mps).all():
        return
    if t_us - stamps[GPS] >= 1e6 * tuning.gps_timeout_s:
        restart_velocity(x, v_ned_mps, tuning.velocity_variance)
    else:
        correct_velocity(x, v_ned_mps, tuning.velocity_variance, work)
    # Fixes may come out of order; the timeout counts from the newest.
    stamps[GPS] = max(t_us, stamps[GPS])


@compiled
def filter_block(
    kind: Indices, t_us: Stamps, values: Vector, state: KernelState, tuning: Tuning
) -> tuple[Stamps, Vector, KernelState]:
    """Run the filter over a block (see `analysis.samples.block`).

    Returns stamps (m,) and q_nb (m, 4) after each IMU sample, then the state.
    """
    when, q_nb = empty_estimates(kind)
    before, stamps, speed_mps, declination_rad = state
    x, stamps, work = before.copy(), stamps.copy(), np.empty((6, 12))
    done = 0
    for i in range(len(kind)):
        if kind[i] == IMU:
            advance_to_sample(x, stamps, t_us[i], values[i], speed_mps, tuning, work)
            when[done] = stamps[STATE]
            for k in range(4):
                q_nb[done, k] = x[k]
            done += 1
        elif kind[i] == MAG:
            correct_heading(x, values[i], declination_rad, tuning.heading_variance, work)
        elif kind[i] == FIX:
            correct_from_fix(x, stamps, t_us[i], values[i], tuning, work)
        elif kind[i] == AIRSPEED:
            speed_mps = airspeed_mps(values[i, 0])
    return when, q_nb, KernelState(x, stamps, speed_mps, declination_rad)


@dataclass(frozen=True)
class Ekf(KernelEstimator):
    """The noise that it assumes, and one sigma of its first attitude, bias and velocity."""

    tuning: Tuning = field(default=Tuning())
    start_sigma: tuple[float, float, float] = (0.05, 0.05, 0.5)  # rad, rad/s, m/s
    filter_block = staticmethod(filter_block)

    def start(self, prior: Prior) -> KernelState:
        """The prior with `start_sigma`; GPS counts as missing until its first fix.

        x (91,) is q_nb, bias in rad/s, velocity NED in m/s, and the covariance (9, 9) by rows.
        """
        # The same for the three axes of each error.
        sigma = np.repeat(self.start_sigma, 3)
        # The bias is unknown at start, so that it begins at zero with its sigma.
        x = np.concatenate([prior.q_nb, np.zeros(3), prior.v_ned_mps, np.diag(sigma**2).ravel()])
        # The last velocity counts as timed out: gravity is used until the first GPS fix.
        timed_out_us = prior.t_us - round(self.tuning.gps_timeout_s * 1e6)
        stamps = np.array([prior.t_us, timed_out_us, prior.t_us])
        return KernelState(x, stamps, 0.0, prior.declination_rad)
