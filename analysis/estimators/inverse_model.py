"""Dead reckoning on the inverse sensor models, integrated by Heun.

The state is (roll, pitch, yaw, u, v, w, north, east, down). Rates and specific force of the IMU
replace the moments and forces in the equations of the rigid body [1]_:

    roll'  = p + (q sin roll + r cos roll) tan pitch
    pitch' = q cos roll - r sin roll
    yaw'   = (q sin roll + r cos roll) / cos pitch
    v_b'   = a - omega x v_b + rot_bn g,    r' = rot_nb v_b

The attitude comes from the gyro alone, so that this estimator shows the effect of a gyro fault that
nothing corrects. Heun's step uses the samples at both of its ends.

References
----------
.. [1] Beard and McLain, Small Unmanned Aircraft, 2012, equations 3.1 to 3.3.
"""

from dataclasses import dataclass
from math import cos, sin
from typing import NamedTuple

import numpy as np

from analysis.estimators.estimator import MAX_GAP_S, AttitudeEstimate, Prior, empty_estimates
from analysis.samples.block import FORCE, IMU, IMU_ID, Block, Indices, Stamps, block_of
from analysis.samples.sample import Sample, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    euler_of_quaternion,
    quaternion_of_euler,
    rotation_matrix,
)

VELOCITY, POSITION, SIZE = 3, 6, 9  # offsets in x, after the angles; length of x
MIN_COS_PITCH = 1e-6  # keeps the Euler rates finite at a pitch of 90 degrees


@compiled
def state_derivative(x: Vector, gyro: Vector, accel: Vector) -> Vector:
    """The right-hand side: x (9,), gyro (3,) in rad/s, accel (3,) in m/s^2 -> (9,)."""
    sf, cf, st, ct = sin(x[0]), cos(x[0]), sin(x[1]), cos(x[1])
    sy, cy = sin(x[2]), cos(x[2])
    u, v, w = x[VELOCITY], x[VELOCITY + 1], x[VELOCITY + 2]
    p, q, r = gyro[0], gyro[1], gyro[2]
    safe = ct if abs(ct) > MIN_COS_PITCH else (MIN_COS_PITCH if ct >= 0.0 else -MIN_COS_PITCH)
    yaw_part = q * sf + r * cf
    out = np.empty(SIZE)
    out[0] = p + yaw_part * st / safe
    out[1] = q * cf - r * sf
    out[2] = yaw_part / safe
    out[VELOCITY] = accel[0] + r * v - q * w - STANDARD_GRAVITY_MPS2 * st
    out[VELOCITY + 1] = accel[1] + p * w - r * u + STANDARD_GRAVITY_MPS2 * ct * sf
    out[VELOCITY + 2] = accel[2] + q * u - p * v + STANDARD_GRAVITY_MPS2 * ct * cf
    out[POSITION] = ct * cy * u + (sf * st * cy - cf * sy) * v + (cf * st * cy + sf * sy) * w
    out[POSITION + 1] = ct * sy * u + (sf * st * sy + cf * cy) * v + (cf * st * sy - sf * cy) * w
    out[POSITION + 2] = -st * u + sf * ct * v + cf * ct * w
    return out


@compiled
def heun_step(
    x: Vector, gyro0: Vector, accel0: Vector, gyro1: Vector, accel1: Vector, dt_s: float
) -> Vector:
    """One step of x (9,) of length `dt_s` between two samples, rates (3,) in rad/s and specific
    force (3,) in m/s^2 each."""
    slope0 = state_derivative(x, gyro0, accel0)
    # The second slope is that at the end of the step, with the sample there.
    slope1 = state_derivative(x + dt_s * slope0, gyro1, accel1)
    return x + 0.5 * dt_s * (slope0 + slope1)


@compiled
def integrate_block(
    kind: Indices, t_us: Stamps, values: Vector, x: Vector, now_us: int, before: Vector
) -> tuple[Stamps, Vector, Vector, int, Vector]:
    """Integrate over a block (see `analysis.samples.block`).

    `before` (6,) is the IMU sample at `now_us`, NaN where it is unknown. Returns stamps (m,) and
    q_nb (m, 4) after each IMU sample, then the state.
    """
    when, q_nb = empty_estimates(kind)
    done = 0
    for i in range(len(kind)):
        if kind[i] != IMU:
            continue
        v = values[i, :IMU_ID]
        # The first sample also serves as the previous one: a single Euler step.
        if np.isnan(before[0]):
            before = v
        dt_s = (t_us[i] - now_us) * 1e-6
        if 0.0 < dt_s <= MAX_GAP_S:
            x = heun_step(x, before[:FORCE], before[FORCE:], v[:FORCE], v[FORCE:], dt_s)
        before, now_us = v, max(t_us[i], now_us)
        q = quaternion_of_euler(x[0], x[1], x[2])
        when[done] = now_us
        for k in range(4):
            q_nb[done, k] = q[k]
        done += 1
    return when, q_nb, x, now_us, before.copy()


class HeunState(NamedTuple):
    """x (9,) as above and the previous IMU sample (6,), NaN without one."""

    t_us: int
    x: Vector
    before: Vector


@dataclass(frozen=True, slots=True)
class InverseModel:
    """Dead reckoning from the prior, without parameters."""

    def start(self, prior: Prior) -> HeunState:
        """The prior as Euler angles, body velocity and position."""
        start = np.concatenate(
            [
                euler_of_quaternion(prior.q_nb),
                rotation_matrix(prior.q_nb).T @ prior.v_ned_mps,
                prior.r_ned_m,
            ]
        )
        return HeunState(prior.t_us, start, np.full(6, np.nan))

    def update(self, reading: Sample, state: HeunState) -> tuple[AttitudeEstimate, HeunState]:
        """Integrate from the previous sample to this one."""
        _, _, state = self.update_block(block_of(reading), state)
        q_nb = quaternion_of_euler(state.x[0], state.x[1], state.x[2])
        return AttitudeEstimate(state.t_us, q_nb), state

    def update_block(self, block: Block, state: HeunState) -> tuple[Stamps, Vector, HeunState]:
        """Update with a block: stamps (m,) and q_nb (m, 4) after each IMU sample, next state."""
        t_us, q_nb, x, now_us, before = integrate_block(
            block.kind, block.t_us, block.values, state.x, state.t_us, state.before
        )
        return t_us, q_nb, HeunState(now_us, x, before)
