"""Limits how well fixes determine the heading: by the vehicle's acceleration over their error's.

The errors of a receiver's velocity last for seconds, so an update gives back the information about
the rotation about the vertical that a fix cannot have: the partial update of [1]_, of state and
covariance alike (docs/fdi.md, "Heading from fixes").

References
----------
.. [1] Brink, Partial-Update Schmidt-Kalman Filter, Journal of Guidance, Control, and Dynamics
   40(9), 2017.
"""

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import BG, ERROR_SIZE, PSI, X_BG, X_Q
from analysis.detection.receiver.carry_off_windows import NATURAL_MPS
from analysis.detection.receiver.drift_return import NATURAL_S
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_in_reference, rotation_matrix


def limit_heading_update(
    before: MotionEstimate, after: MotionEstimate, acceleration_mps2: Vector, axes: Vector
) -> MotionEstimate:
    """`after` an update of `before` by a fix, with no more heading information than the fix has.

    `acceleration_mps2` (3,) is the vehicle's since the last fix, along the NED `axes` (3, 3) in
    ECEF.
    """
    if not (before.inertial and after.inertial):
        return after
    down = axes[2]
    prior, updated = (
        float(down @ motion.p[PSI : PSI + 3, PSI : PSI + 3] @ down) for motion in (before, after)
    )
    error_mps2 = NATURAL_MPS / NATURAL_S
    level_mps2 = float(np.hypot(acceleration_mps2[0], acceleration_mps2[1]))
    allowed = min(prior, (error_mps2 / max(level_mps2, 1e-6)) ** 2)
    if updated >= allowed:
        return after
    share = float(np.sqrt((allowed - updated) / (prior - updated)))
    # The gyro bias about the vertical is limited with it.
    down_b = rotation_matrix(after.x[X_Q:X_BG]).T @ down
    back = np.zeros((ERROR_SIZE, ERROR_SIZE))
    back[PSI : PSI + 3, PSI : PSI + 3] = share * (down[:, None] * down)
    back[BG : BG + 3, BG : BG + 3] = share * (down_b[:, None] * down_b)
    x = after.x.copy()
    turn = -share * _turn_about(down, before.x[X_Q:X_BG], after.x[X_Q:X_BG]) * down
    x[X_Q:X_BG] = rotate_in_reference(x[X_Q:X_BG], *turn)
    change = after.x[X_BG : X_BG + 3] - before.x[X_BG : X_BG + 3]
    x[X_BG : X_BG + 3] -= share * (down_b @ change) * down_b
    p = after.p + back @ (before.p - after.p) @ back.T
    return after._replace(x=x, p=0.5 * (p + p.T))


def _turn_about(axis: Vector, q: Vector, after: Vector) -> float:
    """The small turn from an attitude (4,) to another, about an axis (3,) of the reference."""
    change = rotation_matrix(after) @ rotation_matrix(q).T
    turn = 0.5 * np.array(
        [change[2, 1] - change[1, 2], change[0, 2] - change[2, 0], change[1, 0] - change[0, 1]]
    )
    return float(axis @ turn)
