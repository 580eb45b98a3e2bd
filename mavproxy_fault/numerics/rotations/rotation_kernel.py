"""Single rotations for compiled callers; `rotation` has them for arrays.

Quaternions are (w, x, y, z), body to NED. A test compares the two implementations.
"""

from collections.abc import Callable
from math import atan2, cos, pi, sin, sqrt
from typing import cast

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles

Quaternion = tuple[float, float, float, float]
Axis = tuple[float, float, float]
Errors = tuple[float, float, float, float]

euler_of_quaternion = cast(Callable[[Array | Quaternion], Axis], compiled(euler_angles))


@compiled
def quaternion_of_rotation(rx: float, ry: float, rz: float) -> Quaternion:
    """Return the unit quaternion of a rotation vector [rad]."""
    angle = sqrt(rx * rx + ry * ry + rz * rz)
    # sin(angle / 2) / angle by its series, where the quotient would lose digits
    factor = 0.5 - angle * angle / 48.0 if angle < 1e-4 else sin(0.5 * angle) / angle
    return cos(0.5 * angle), factor * rx, factor * ry, factor * rz


@compiled
def rotate_in_place(q: Array, by: Quaternion) -> None:
    """Rotate the attitude q[:4] in place, in body axes."""
    w, x, y, z = by
    a, b, c, d = q[0], q[1], q[2], q[3]
    q0 = a * w - b * x - c * y - d * z
    q1 = a * x + b * w + c * z - d * y
    q2 = a * y - b * z + c * w + d * x
    q3 = a * z + b * y - c * x + d * w
    # Normalised, since rounding accumulates over many small rotations.
    norm = sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    q[0], q[1], q[2], q[3] = q0 / norm, q1 / norm, q2 / norm, q3 / norm


@compiled
def rotate_attitude(q: Array, rx: float, ry: float, rz: float) -> Array:
    """Return q (4,) rotated by the rotation vector (rx, ry, rz) [rad] in body axes."""
    out = q.copy()
    rotate_in_place(out, quaternion_of_rotation(rx, ry, rz))
    return out


@compiled
def rotate_in_reference(q: Array, rx: float, ry: float, rz: float) -> Array:
    """Return q (4,) rotated by a rotation vector [rad] in the reference axes (NED, ECEF)."""
    out = np.empty(4)
    out[0], out[1], out[2], out[3] = quaternion_of_rotation(rx, ry, rz)
    # Rotation times attitude: the axes are then those of the reference.
    rotate_in_place(out, (q[0], q[1], q[2], q[3]))
    return out


@compiled
def body_axes(q: Array) -> tuple[Axis, Axis, Axis]:
    """Return the rows of rot_nb of the attitude q[:4]."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@compiled
def rotation_matrix(q: Array) -> Array:
    """Return rot_nb (3, 3) of q (4,)."""
    north, east, down = body_axes(q)
    out = np.empty((3, 3))
    for i in range(3):
        out[0, i], out[1, i], out[2, i] = north[i], east[i], down[i]
    return out


@inlined
def to_body(
    e0: float, e1: float, e2: float, e3: float, n: float, e: float, d: float
) -> tuple[float, float, float]:
    """Rotate a NED vector to body axes."""
    x = (
        (e0 * e0 + e1 * e1 - e2 * e2 - e3 * e3) * n
        + 2.0 * (e1 * e2 + e0 * e3) * e
        + 2.0 * (e1 * e3 - e0 * e2) * d
    )
    y = (
        2.0 * (e1 * e2 - e0 * e3) * n
        + (e0 * e0 - e1 * e1 + e2 * e2 - e3 * e3) * e
        + 2.0 * (e2 * e3 + e0 * e1) * d
    )
    z = (
        2.0 * (e1 * e3 + e0 * e2) * n
        + 2.0 * (e2 * e3 - e0 * e1) * e
        + (e0 * e0 - e1 * e1 - e2 * e2 + e3 * e3) * d
    )
    return x, y, z


@inlined
def to_ned(
    e0: float, e1: float, e2: float, e3: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Rotate a body vector to NED."""
    return to_body(e0, -e1, -e2, -e3, x, y, z)


@compiled
def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> Array:
    """Return the quaternion (4,) of 3-2-1 Euler angles [rad]."""
    cr, sr = cos(0.5 * roll), sin(0.5 * roll)
    cp, sp = cos(0.5 * pitch), sin(0.5 * pitch)
    cy, sy = cos(0.5 * yaw), sin(0.5 * yaw)
    out = np.empty(4)
    out[0] = cr * cp * cy + sr * sp * sy
    out[1] = sr * cp * cy - cr * sp * sy
    out[2] = cr * sp * cy + sr * cp * sy
    out[3] = cr * cp * sy - sr * sp * cy
    return out


@compiled
def wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to (-pi, pi] [rad]."""
    # The usual case, and bit-exact.
    if -pi < angle_rad <= pi:
        return angle_rad
    return atan2(sin(angle_rad), cos(angle_rad))


@compiled
def heading_error(q: Array, field: Array, declination_rad: float) -> float:
    """Return the rotation about down that aligns the measured field (3,) with the declination."""
    rot = rotation_matrix(q)
    north = rot[0, 0] * field[0] + rot[0, 1] * field[1] + rot[0, 2] * field[2]
    east = rot[1, 0] * field[0] + rot[1, 1] * field[1] + rot[1, 2] * field[2]
    return wrap_angle(declination_rad - atan2(east, north))


@compiled
def gravity_error(
    q: Array, accel: Array, gyro: Array, speed_mps: float, gravity_mps2: float
) -> Array:
    """Return the body rotation vector (3,) from the estimated to the measured down.

    The centripetal part of the specific force is removed for a flight along the nose. The result
    is scaled down as the force departs from 1 g, where it contains little information on down.
    """
    fx = accel[0]
    fy = accel[1] - gyro[2] * speed_mps
    fz = accel[2] + gyro[1] * speed_mps
    norm = sqrt(fx * fx + fy * fy + fz * fz)
    trust = max(0.0, 1.0 - abs(norm / gravity_mps2 - 1.0))
    scale = 0.0 if norm == 0.0 else -trust / norm
    rot = rotation_matrix(q)
    dx, dy, dz = rot[2, 0], rot[2, 1], rot[2, 2]
    mx, my, mz = scale * fx, scale * fy, scale * fz
    out = np.empty(3)
    # The cross product is along the axis and has the sine of the angle as length.
    out[0] = my * dz - mz * dy
    out[1] = mz * dx - mx * dz
    out[2] = mx * dy - my * dx
    return out


@compiled
def attitude_errors(q_estimate: Array | Quaternion, q_truth: Array | Quaternion) -> Errors:
    """Return the wrapped differences of roll, pitch and yaw of two quaternions (4,), and the angle
    of the rotation between them [rad]."""
    a, b = q_estimate, q_truth
    roll_a, pitch_a, yaw_a = euler_of_quaternion(a)
    roll_b, pitch_b, yaw_b = euler_of_quaternion(b)
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    # abs: the shorter rotation; the arc cosine would lose digits of small angles.
    angle_rad = 2.0 * atan2(sqrt(x * x + y * y + z * z), abs(w))
    return (
        wrap_angle(roll_a - roll_b),
        wrap_angle(pitch_a - pitch_b),
        wrap_angle(yaw_a - yaw_b),
        angle_rad,
    )


@compiled
def interpolate_attitude(q0: Quaternion, q1: Quaternion, share: float) -> Quaternion:
    """Interpolate from q0 (share 0) to q1 (share 1) along the shorter path, normalised linear."""
    dot = q0[0] * q1[0] + q0[1] * q1[1] + q0[2] * q1[2] + q0[3] * q1[3]
    # q and -q are the same attitude; use the nearer one.
    other = share if dot >= 0.0 else -share
    one = 1.0 - share
    w, x = one * q0[0] + other * q1[0], one * q0[1] + other * q1[1]
    y, z = one * q0[2] + other * q1[2], one * q0[3] + other * q1[3]
    norm = sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm
