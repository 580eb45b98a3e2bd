"""Rotations of single vectors and attitudes in Python floats.

They are ten times as fast as numpy arrays of one element, and let a proxy start without numpy,
whose import takes a third of the start-up time. `rotation` has the same for arrays.
"""

import math
from collections.abc import Sequence

Matrix = tuple[tuple[float, float, float], ...]


def euler_angles(q_nb: Sequence[float]) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of one quaternion; also compiled."""
    w, x, y, z = q_nb[0], q_nb[1], q_nb[2], q_nb[3]
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        # Rounding may make the sine exceed one when the nose is vertical.
        math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def rotate_to_body(q_nb: Sequence[float], v_ned: Sequence[float]) -> tuple[float, float, float]:
    """Rotate one NED vector to body axes."""
    w, x, y, z = q_nb
    n, e, d = v_ned
    # v + 2 q x (q x v + w v), with q conjugated.
    tn, te, td = 2.0 * (e * z - d * y), 2.0 * (d * x - n * z), 2.0 * (n * y - e * x)
    return (
        n + w * tn + te * z - td * y,
        e + w * te + td * x - tn * z,
        d + w * td + tn * y - te * x,
    )


def body_matrix(roll: float, pitch: float, yaw: float) -> Matrix:
    """Return the matrix that rotates a vector to axes rotated by yaw, pitch, roll [rad]."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        (cp * cy, cp * sy, -sp),
        (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    )


def rotate_quaternion(
    q_nb: Sequence[float], rotvec_b: Sequence[float]
) -> tuple[float, float, float, float]:
    """Rotate one attitude by a small rotation vector in body axes [rad]."""
    w, x, y, z = q_nb
    a, b, c = rotvec_b
    half = 0.5 * math.sqrt(a * a + b * b + c * c)
    # The limit for no rotation, where the quotient is 0 / 0.
    scale = 0.5 * math.sin(half) / half if half > 0.0 else 0.5
    a, b, c, s = scale * a, scale * b, scale * c, math.cos(half)
    return (
        w * s - x * a - y * b - z * c,
        w * a + x * s + y * c - z * b,
        w * b - x * c + y * s + z * a,
        w * c + x * b - y * a + z * s,
    )
