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
from typing import NamedTuple

import numpy as np

from analysis.estimators.estimator import MAX_GAP_S, AttitudeEstimate, Prior, empty_estimates
from analysis.samples.block import IMU, IMU_ID, Block, Indices, Stamps, block_of
from analysis.samples.sample import Sample, Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.polynomial import sin_cos
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    euler_of_quaternion,
    quaternion_of_euler,
    rotation_matrix,
)

Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]
VELOCITY, POSITION = 3, 6  # offsets in x, after the angles
MIN_COS_PITCH = 1e-6  # keeps the Euler rates finite at a pitch of 90 degrees


@inlined
def state_derivative(x: Nine, gyro: Three, accel: Three) -> Nine:
    """The right-hand side, gyro in rad/s, accel in m/s^2."""
    roll, pitch, yaw, u, v, w, _, _, _ = x
    sf, cf = sin_cos(roll)
    st, ct = sin_cos(pitch)
    sy, cy = sin_cos(yaw)
    p, q, r = gyro
    bound = MIN_COS_PITCH if ct >= 0.0 else -MIN_COS_PITCH
    inverse = 1.0 / (ct if abs(ct) > MIN_COS_PITCH else bound)
    yaw_part = q * sf + r * cf
    return (
        p + yaw_part * st * inverse,
        q * cf - r * sf,
        yaw_part * inverse,
        accel[0] + r * v - q * w - STANDARD_GRAVITY_MPS2 * st,
        accel[1] + p * w - r * u + STANDARD_GRAVITY_MPS2 * ct * sf,
        accel[2] + q * u - p * v + STANDARD_GRAVITY_MPS2 * ct * cf,
        ct * cy * u + (sf * st * cy - cf * sy) * v + (cf * st * cy + sf * sy) * w,
        ct * sy * u + (sf * st * sy + cf * cy) * v + (cf * st * sy - sf * cy) * w,
        -st * u + sf * ct * v + cf * ct * w,
    )


@inlined
def add_scaled(x: Nine, slope: Nine, dt_s: float) -> Nine:
    """x + dt slope."""
    # Written out, as a loop over a tuple would keep LLVM from making SIMD code of it.
    roll, pitch, yaw, u, v, w, north, east, down = x
    d_roll, d_pitch, d_yaw, du, dv, dw, dn, de, dd = slope
    return (
        roll + dt_s * d_roll,
        pitch + dt_s * d_pitch,
        yaw + dt_s * d_yaw,
        u + dt_s * du,
        v + dt_s * dv,
        w + dt_s * dw,
        north + dt_s * dn,
        east + dt_s * de,
        down + dt_s * dd,
    )


@inlined
def heun_step(x: Nine, before: tuple[Three, Three], after: tuple[Three, Three], dt: float) -> Nine:
    """One step between two samples, each rates and specific force."""
    first = state_derivative(x, before[0], before[1])
    # The second slope is that at the end of the step, with the sample there.
    second = state_derivative(add_scaled(x, first, dt), after[0], after[1])
    return add_scaled(x, add_scaled(first, second, 1.0), 0.5 * dt)


@inlined
def imu_sample(v: Vector) -> tuple[Three, Three]:
    """Rates and specific force of a sample (6,)."""
    return (v[0], v[1], v[2]), (v[3], v[4], v[5])


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
            start = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8])
            x = np.array(heun_step(start, imu_sample(before), imu_sample(v), dt_s))
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
