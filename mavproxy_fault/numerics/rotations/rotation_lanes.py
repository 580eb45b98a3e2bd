"""Rotations without branches, for SIMD loops over lanes.

A test compares them with `rotation_kernel`.
"""

from math import pi

import numpy as np

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import atan2, sin_cos

_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to the nearest integer


@inlined
def euler_of_quaternion(e0: float, e1: float, e2: float, e3: float) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of a unit quaternion."""
    sine = 2.0 * (e0 * e2 - e3 * e1)
    rest = 1.0 - sine * sine
    return (
        atan2(2.0 * (e0 * e1 + e2 * e3), 1.0 - 2.0 * (e1 * e1 + e2 * e2)),
        # By the arc tangent, since there is no arc sine; a sine above one by rounding is one.
        atan2(sine, np.sqrt(rest if rest > 0.0 else 0.0)),
        atan2(2.0 * (e0 * e3 + e1 * e2), 1.0 - 2.0 * (e2 * e2 + e3 * e3)),
    )


@inlined
def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion of 3-2-1 Euler angles [rad]."""
    sr, cr = sin_cos(0.5 * roll)
    sp, cp = sin_cos(0.5 * pitch)
    sy, cy = sin_cos(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@inlined
def wrap_angle(angle: float) -> float:
    """Wrap an angle to [-pi, pi]."""
    revolutions = angle * (0.5 / pi) + _ROUND
    # Without the constant, the number of whole revolutions.
    return angle - 2.0 * pi * (revolutions - _ROUND)
