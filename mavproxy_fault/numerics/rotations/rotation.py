"""Rotations of arrays: unit quaternions (w, x, y, z), rotation matrices and 3-2-1 Euler angles.

`q_nb` rotates body vectors to NED. Every function works on the last axis of arrays of any shape.
`one_rotation` is for single values, without numpy.
Formulas: Diebel, Representing Attitude, Stanford, 2006.
"""

import numpy as np
from numpy.typing import ArrayLike

from mavproxy_fault.numerics.arrays import Array


def quat_from_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Return the quaternion (..., 4) of yaw, pitch and roll [rad], in this order, moving axes."""
    half = [0.5 * np.asarray(angle, dtype=float) for angle in (roll, pitch, yaw)]
    (cr, cp, cy), (sr, sp, sy) = [np.cos(h) for h in half], [np.sin(h) for h in half]
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def euler_from_quat(q: ArrayLike) -> Array:
    """Return roll, pitch, yaw (..., 3) [rad] of quaternions; pitch within +-pi/2."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    # Rounding may make the sine exceed one when the nose is vertical.
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def matrix_from_quat(q: ArrayLike) -> Array:
    """Return the rotation matrix (..., 3, 3) of quaternions."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_matrix(rot: ArrayLike) -> Array:
    """Return the quaternion (..., 4), w >= 0, of rotation matrices (..., 3, 3)."""
    m = np.asarray(rot, dtype=float)
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # Four times the square of each component; dividing by the largest is well conditioned.
    squares = np.stack(
        [1.0 + d0 + d1 + d2, 1.0 + d0 - d1 - d2, 1.0 - d0 + d1 - d2, 1.0 - d0 - d1 + d2], axis=-1
    )
    wx, wy, wz = (
        m[..., 2, 1] - m[..., 1, 2],
        m[..., 0, 2] - m[..., 2, 0],
        m[..., 1, 0] - m[..., 0, 1],
    )
    xy, xz, yz = (
        m[..., 0, 1] + m[..., 1, 0],
        m[..., 0, 2] + m[..., 2, 0],
        m[..., 1, 2] + m[..., 2, 1],
    )
    candidates = np.stack(
        [
            np.stack([squares[..., 0], wx, wy, wz], axis=-1),
            np.stack([wx, squares[..., 1], xy, xz], axis=-1),
            np.stack([wy, xy, squares[..., 2], yz], axis=-1),
            np.stack([wz, xz, yz, squares[..., 3]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def wrap_degrees(angle_deg: ArrayLike) -> Array:
    """Angles in degrees within (-180, 180]; longitudes and headings are equal modulo 360."""
    return np.asarray(180.0 - (180.0 - np.asarray(angle_deg, float)) % 360.0)


def wrap_angles(angle: ArrayLike) -> Array:
    """Wrap angles to [-pi, pi) [rad]."""
    # The remainder has the divisor's sign, so negative angles need no special case.
    return np.asarray((np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi)
