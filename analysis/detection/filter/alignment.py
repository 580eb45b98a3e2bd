"""Attitude from scratch: the specific force integrated by the IMU against GNSS velocity.

In axes fixed at the start (0), alpha = integral of C_0b f dt; by GNSS the same vector in ECEF is
beta = v - v_0 - integral of (g - 2 Omega x v) dt. The rotation C_e0 with beta = C_e0 alpha for all
epochs is Wahba's problem, solved by the singular value decomposition [1]_ [2]_. Gravity alone
gives tilt; heading needs horizontal acceleration, or the magnetometer as one more pair.

References
----------
.. [1] M. Wu and X. Pan, IEEE Trans. Aerospace and Electronic Systems 49(1), 2013.
.. [2] F. L. Markley, J. Astronautical Sciences 36(3), 1988.
"""

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import Alignment, ImuStatus, MotionEstimate
from analysis.detection.filter.inertial import (
    ACCEL_BIAS_SIGMA_MPS2,
    BA,
    BG,
    ERROR_SIZE,
    GYRO,
    GYRO_BIAS_SIGMA_RPS,
    PSI,
    gravity_ecef,
    unmeasured_variances,
)
from analysis.detection.filter.propagation import ImuSegment
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS
from mavproxy_fault.numerics.earth_kernel import local_axes
from mavproxy_fault.numerics.rotations.rotation import quat_from_matrix
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_attitude, rotation_matrix

LONGEST_ALIGNMENT_S = 20.0  # then it restarts: GYRO_BIAS_SIGMA_RPS turns it by 0.4 rad
SHORTEST_ALIGNMENT_S = 2.0  # a shorter one would rest on the noise of a few velocities
SLOWEST_SAMPLING_S = 0.07  # mean interval of an IMU that may propagate the filter: 14 Hz
HEADING_BY_MOTION_RAD = 0.12  # one sigma at which the attitude counts as found: 7 degrees
HEADING_BY_MAG_RAD = 0.35  # declination unknown: 20 degrees
MAG_AFTER_S = 4.0  # motion has this long to give the better heading alone
# Errors common to the epochs of an alignment, which the filter's own variance leaves out.
VELOCITY_FLOOR_MPS = 0.2
ALIGNMENT_FLOOR_RAD = 0.05  # gyro bias and timing over the alignment
LOST_TILT_RAD = 0.35  # 20 degrees: the filter is linear in the error of the tilt


@compiled
def _integrate(q: Vector, alpha: Vector, samples: Vector) -> tuple[Vector, Vector]:
    alpha = alpha.copy()
    for k in range(samples.shape[0]):
        dt = samples[k, 0]
        rx, ry, rz = samples[k, GYRO] * dt, samples[k, GYRO + 1] * dt, samples[k, GYRO + 2] * dt
        # The attitude at mid-step: the first order of the turn within the step cancels.
        mid = rotation_matrix(rotate_attitude(q, 0.5 * rx, 0.5 * ry, 0.5 * rz))
        for i in range(3):
            for j in range(3):
                alpha[i] += mid[i, j] * samples[k, 4 + j] * dt
        q = rotate_attitude(q, rx, ry, rz)
    return q, alpha


def new_alignment(motion: MotionEstimate) -> Alignment:
    """An alignment that starts at the filter's epoch."""
    unit = np.array([1.0, 0.0, 0.0, 0.0])
    nothing = np.zeros((3, 3))
    still = np.zeros(3)
    return Alignment(motion.t_us, unit, still, still, motion.x[3:6].copy(), nothing, nothing)


def extend_alignment(
    alignment: Alignment, motion: MotionEstimate, samples: Vector, dt_s: float
) -> Alignment:
    """The alignment after one epoch more, with the IMU's samples (k, 7) since the last one."""
    q, alpha = _integrate(alignment.q_0b, alignment.alpha, samples)
    (speed, turn), (added_speed, added_turn) = alignment.unsampled, unmeasured_variances(samples)
    speed, turn = speed + added_speed, turn + added_turn
    v = motion.x[3:6]
    # Coriolis over the interval by the mean velocity of its two ends.
    mean = 0.5 * (v + alignment.v_ecef_mps)
    coriolis = 2.0 * GNSS_EARTH_RATE_RPS * np.array([mean[1], -mean[0], 0.0])
    gravity = gravity_ecef(motion.x[0:3])
    beta = alignment.beta + v - alignment.v_ecef_mps - (gravity + coriolis) * dt_s
    variance = float(np.trace(motion.p[3:6, 3:6])) / 3.0 + VELOCITY_FLOOR_MPS**2
    variance += speed + turn * float(alpha @ alpha)
    cross = alignment.cross + np.outer(beta, alpha) / variance
    # A pair of parallel vectors does not observe a rotation about them: hence the projection.
    information = (
        alignment.information + (beta @ beta * np.eye(3) - np.outer(beta, beta)) / variance
    )
    unsampled = (speed, turn)
    return Alignment(alignment.start_us, q, alpha, beta, v.copy(), cross, information, unsampled)


def finish_alignment(
    alignment: Alignment, motion: MotionEstimate, mag_b: Vector | None
) -> MotionEstimate | None:
    """The filter with its attitude found, propagated by the IMU from here; None while it is not.

    `mag_b` (3,) is the field in body axes, in any unit: its direction alone is used.
    """
    span_s = (motion.t_us - alignment.start_us) * 1e-6
    if span_s < SHORTEST_ALIGNMENT_S:
        return None
    cross, information = alignment.cross, alignment.information
    limit = HEADING_BY_MOTION_RAD
    if mag_b is not None and span_s >= MAG_AFTER_S:
        alpha, north = _mag_pair(alignment, motion, mag_b)
        cross = cross + np.outer(north, alpha) / HEADING_BY_MAG_RAD**2
        information = information + (np.eye(3) - np.outer(north, north)) / HEADING_BY_MAG_RAD**2
        # A heading by the magnetometer alone must pass, so the limit lies above its own sigma.
        limit = 1.1 * HEADING_BY_MAG_RAD
    # The weakest axis decides, less the rotation that may have happened between two samples.
    turn = alignment.unsampled[1]
    if np.linalg.eigvalsh(information)[0] * (limit**2 - turn) < 1.0:
        return None
    left, _, right = np.linalg.svd(cross)
    # The determinant keeps a rotation: without it noise can make a reflection the best fit.
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    x, p = motion.x.copy(), motion.p.copy()
    x[6:10] = quat_from_matrix(rotation @ rotation_matrix(alignment.q_0b))
    # Biases are not separable from the attitude in so short a time: they begin at zero.
    x[10:16] = 0.0
    for at in (PSI, BG, BA):
        # Correlations of the old attitude with anything else are void.
        p[at : at + 3, :] = 0.0
        p[:, at : at + 3] = 0.0
    p[PSI : PSI + 3, PSI : PSI + 3] = np.linalg.inv(information) + (
        ALIGNMENT_FLOOR_RAD**2 + turn
    ) * np.eye(3)
    for at, sigma in ((BG, GYRO_BIAS_SIGMA_RPS), (BA, ACCEL_BIAS_SIGMA_MPS2)):
        p[range(at, at + 3), range(at, at + 3)] = sigma**2
    assert p.shape == (ERROR_SIZE, ERROR_SIZE)
    return MotionEstimate(motion.t_us, x, p, True)


def _lost(motion: MotionEstimate) -> bool:
    """Whether the filter has lost the tilt about the axis where it is least certain."""
    p = motion.p[PSI : PSI + 3, PSI : PSI + 3]
    # No axis is less certain than all three together: the usual epoch ends here.
    if p[0, 0] + p[1, 1] + p[2, 2] < LOST_TILT_RAD**2:
        return False
    level = local_axes(motion.x[0:3])[:2]
    return bool(np.linalg.eigvalsh(level @ p @ level.T)[1] >= LOST_TILT_RAD**2)


def _mag_pair(alignment: Alignment, motion: MotionEstimate, mag_b: Vector) -> tuple[Vector, Vector]:
    """The field's horizontal direction in the start's axes, and north in ECEF."""
    # The integrated specific force points up while the vehicle hardly accelerates.
    up = alignment.alpha / np.linalg.norm(alignment.alpha)
    field = rotation_matrix(alignment.q_0b) @ mag_b
    level = field - (field @ up) * up
    north = local_axes(motion.x[0:3])[0]
    # A field straight along the vertical has no horizontal direction: no division by zero.
    return level / max(float(np.linalg.norm(level)), 1e-9), north


def align_attitude(
    imu: ImuStatus,
    motion: MotionEstimate,
    segment: ImuSegment,
    dt_s: float,
    config: FilterConfig,
) -> MotionEstimate:
    """The filter after an epoch: an unknown attitude is searched for, and the IMU is used once it
    is found; a lost attitude is searched for again."""
    if motion.inertial:
        return motion._replace(inertial=False) if _lost(motion) else motion
    if not len(segment.samples) or segment.gap_s > config.gap_s:
        return motion
    # Between samples so far apart a vehicle rotates unmeasured.
    if dt_s > SLOWEST_SAMPLING_S * (len(segment.samples) - 1):
        return motion._replace(alignment=None)
    # A suspended IMU gives no attitude.
    if imu.suspended_until_us is not None and motion.t_us < imu.suspended_until_us:
        return motion
    alignment = motion.alignment
    if alignment is None or (motion.t_us - alignment.start_us) * 1e-6 > LONGEST_ALIGNMENT_S:
        return motion._replace(alignment=new_alignment(motion))
    alignment = extend_alignment(alignment, motion, segment.samples, dt_s)
    found = finish_alignment(alignment, motion, imu.mag_b)
    return found if found is not None else motion._replace(alignment=alignment)
