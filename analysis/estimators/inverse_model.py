"""Dead reckoning on the inverse sensor models, integrated by Heun.

The state is (roll, pitch, yaw, u, v, w, north, east, down). Rates and specific force of the IMU
take the place of the moments and forces in the equations of the rigid body [1]_:

    roll'  = p + (q sin roll + r cos roll) tan pitch
    pitch' = q cos roll - r sin roll
    yaw'   = (q sin roll + r cos roll) / cos pitch
    v_b'   = a - omega x v_b + rot_bn g,    r' = rot_nb v_b

The attitude follows from the gyro alone, so that this estimator shows what a gyro fault does when
nothing corrects it. Heun's step uses both samples that bound it.

References
----------
.. [1] Beard and McLain, Small Unmanned Aircraft, 2012, equations 3.1 to 3.3.
"""

from dataclasses import dataclass
from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import GRAVITY_MPS2, MAX_GAP_S, AttitudeEstimate, Prior
from analysis.estimators.rotations import euler, matrix, quaternion_of_euler
from analysis.samples import ImuSample, Sample
from mavproxy_fault.wire.compiled import compiled

Vector = NDArray[np.float64]
MIN_COS_PITCH = 1e-6  # keeps the Euler rates finite at the pole


@compiled
def derivative(x: Vector, gyro: Vector, accel: Vector) -> Vector:
    """The right-hand side: x (9,), gyro (3,) in rad/s, accel (3,) in m/s^2 -> (9,)."""
    sf, cf, st, ct = sin(x[0]), cos(x[0]), sin(x[1]), cos(x[1])
    sy, cy = sin(x[2]), cos(x[2])
    u, v, w = x[3], x[4], x[5]
    p, q, r = gyro[0], gyro[1], gyro[2]
    safe = ct if abs(ct) > MIN_COS_PITCH else (MIN_COS_PITCH if ct >= 0.0 else -MIN_COS_PITCH)
    turn = q * sf + r * cf
    out = np.empty(9)
    out[0] = p + turn * st / safe
    out[1] = q * cf - r * sf
    out[2] = turn / safe
    out[3] = accel[0] + r * v - q * w - GRAVITY_MPS2 * st
    out[4] = accel[1] + p * w - r * u + GRAVITY_MPS2 * ct * sf
    out[5] = accel[2] + q * u - p * v + GRAVITY_MPS2 * ct * cf
    out[6] = ct * cy * u + (sf * st * cy - cf * sy) * v + (cf * st * cy + sf * sy) * w
    out[7] = ct * sy * u + (sf * st * sy + cf * cy) * v + (cf * st * sy - sf * cy) * w
    out[8] = -st * u + sf * ct * v + cf * ct * w
    return out


@compiled
def heun(
    x: Vector, gyro0: Vector, accel0: Vector, gyro1: Vector, accel1: Vector, dt_s: float
) -> Vector:
    """One step of length `dt_s` between two samples."""
    slope0 = derivative(x, gyro0, accel0)
    slope1 = derivative(x + dt_s * slope0, gyro1, accel1)
    return x + 0.5 * dt_s * (slope0 + slope1)


class HeunState(NamedTuple):
    """x (9,) as above and the sample before."""

    t_us: int
    x: Vector
    before: ImuSample | None


@dataclass(frozen=True, slots=True)
class InverseModel:
    """The reference estimator of random-testing programs; starts at the prior."""

    def start(self, prior: Prior) -> HeunState:
        """The prior as Euler angles, body velocity and position."""
        start = np.concatenate(
            [euler(prior.q_nb), matrix(prior.q_nb).T @ prior.v_ned_mps, prior.r_ned_m]
        )
        return HeunState(prior.t_us, start, None)

    def update(self, reading: Sample, state: HeunState) -> tuple[AttitudeEstimate, HeunState]:
        """Integrate from the sample before to this one."""
        if not isinstance(reading, ImuSample):
            return _estimate(state), state
        first = reading if state.before is None else state.before
        dt_s = (reading.t_us - state.t_us) * 1e-6
        x = state.x
        if 0.0 < dt_s <= MAX_GAP_S:
            x = heun(
                x,
                first.gyro_b_rps,
                first.accel_b_mps2,
                reading.gyro_b_rps,
                reading.accel_b_mps2,
                dt_s,
            )
        moved = HeunState(max(reading.t_us, state.t_us), x, reading)
        return _estimate(moved), moved


def _estimate(state: HeunState) -> AttitudeEstimate:
    return AttitudeEstimate(state.t_us, quaternion_of_euler(state.x[0], state.x[1], state.x[2]))
