"""Errors of the estimate against the truth, over lanes."""

import numpy as np

from analysis.estimators.inverse_model import POSITION, VELOCITY
from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, four_at, put_three, three_at, true_attitude
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.polynomial import atan2
from mavproxy_fault.numerics.rotations.rotation_lanes import euler_of_quaternion, wrap_angle
from simvehicle.vehicles.rigidbody_kernel import P, U

L = rows.LANES
NOW = rows.NOW * L
E, Q = rows.ESTIMATE * L, rows.QUATERNION * L
SQ, LG = rows.SQUARES * L, rows.LARGEST * L
ALIVE, COUNT = rows.ALIVE * L, rows.COUNT * L
ANGLE = 3  # among the scores, behind roll, pitch and yaw
M, T = rows.MEASURED * L, rows.STATE_SQUARES * L


@compiled
def euler_of_quaternions(buf: Buffer) -> None:
    """The first three rows of ESTIMATE from QUATERNION."""
    for lane in range(L):
        put_three(buf, E, lane, euler_of_quaternion(*four_at(buf, Q, lane)))


@compiled
def score_euler(buf: Buffer) -> None:
    """Add the errors of roll, pitch and yaw at this instant to the scores of living lanes."""
    wide()
    for lane in range(L):
        alive = buf[ALIVE + lane] > 0.5
        buf[COUNT + lane] += 1.0 if alive else 0.0
        true, found = euler_of_quaternion(*true_attitude(buf, lane)), three_at(buf, E, lane)
        for i in range(3):
            error = wrap_angle(found[i] - true[i])
            error = error if alive else 0.0
            buf[SQ + i * L + lane] += error * error
            buf[LG + i * L + lane] = max(abs(error), buf[LG + i * L + lane])


@compiled
def score_angle(buf: Buffer) -> None:
    """Add the angle between estimate and truth to the scores of living lanes."""
    wide()
    for lane in range(L):
        alive = buf[ALIVE + lane] > 0.5
        (e0, e1, e2, e3), (a0, a1, a2, a3) = true_attitude(buf, lane), four_at(buf, Q, lane)
        w = a0 * e0 + a1 * e1 + a2 * e2 + a3 * e3
        x = a0 * e1 - a1 * e0 - a2 * e3 + a3 * e2
        y = a0 * e2 + a1 * e3 - a2 * e0 - a3 * e1
        z = a0 * e3 - a1 * e2 + a2 * e1 - a3 * e0
        angle = 2.0 * atan2(np.sqrt(x * x + y * y + z * z), abs(w))
        angle = angle if alive else 0.0
        buf[SQ + ANGLE * L + lane] += angle * angle
        buf[LG + ANGLE * L + lane] = max(angle, buf[LG + ANGLE * L + lane])


@compiled
def score_state(buf: Buffer) -> None:
    """Add the errors of all twelve states to the scores of living lanes; the rates are the gyro's.

    Position (NED), velocity (body), angles and rates, in the order of STATE_SQUARES.
    """
    for lane in range(L):
        roll, pitch, yaw = euler_of_quaternion(*true_attitude(buf, lane))
        alive = buf[ALIVE + lane] > 0.5
        for i in range(3):
            place = buf[E + (POSITION + i) * L + lane] - buf[NOW + i * L + lane]
            speed = buf[E + (VELOCITY + i) * L + lane] - buf[NOW + (U + i) * L + lane]
            true = roll if i == 0 else pitch if i == 1 else yaw
            angle = wrap_angle(buf[E + i * L + lane] - true)
            rate = buf[M + i * L + lane] - buf[NOW + (P + i) * L + lane]
            squares = (place * place, speed * speed, angle * angle, rate * rate)
            for k in range(4):
                buf[T + (3 * k + i) * L + lane] += squares[k] if alive else 0.0
