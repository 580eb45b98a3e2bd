"""The antenna's lever arm: the filter's position and velocity are the antenna's at every epoch.

The IMU propagates the filter from one epoch to the next at its own position (docs/fdi.md, "Filter";
Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation, 2nd ed., 14.3.1).
"""

import numpy as np

from analysis.detection.filter.inertial import BG, ERROR_SIZE, PSI, X_BG, X_Q, R, V
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix


def shift_by_lever_arm(
    x: Vector, p: Vector, gyro_b_rps: Vector, arm_b_m: Vector, sign: float
) -> tuple[Vector, Vector, Vector]:
    """State and covariance at the antenna (sign 1) of those at the IMU, or back (-1).

    Parameters
    ----------
    x, p : (21,) and (20, 20)
    gyro_b_rps, arm_b_m : (3,), the gyro's reading and the arm from IMU to antenna

    Returns
    -------
    x, p and the matrix (20, 20) that turns the errors of the one into those of the other.
    """
    c = rotation_matrix(x[X_Q : X_Q + 4])
    # The Earth's rotation seen in body axes is the last row of C times its rate.
    turning = gyro_b_rps - x[X_BG : X_BG + 3] - GNSS_EARTH_RATE_RPS * c[2]
    arm, speed = c @ arm_b_m, c @ np.cross(turning, arm_b_m)
    jacobian = np.eye(ERROR_SIZE)
    jacobian[R : R + 3, PSI : PSI + 3] = -sign * _cross(arm)
    jacobian[V : V + 3, PSI : PSI + 3] = -sign * _cross(speed)
    jacobian[V : V + 3, BG : BG + 3] = sign * c @ _cross(arm_b_m)
    x = x.copy()
    x[R : R + 3] += sign * arm
    x[V : V + 3] += sign * speed
    return x, jacobian @ p @ jacobian.T, jacobian


def _cross(v: Vector) -> Vector:
    """[v]x (3, 3)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
