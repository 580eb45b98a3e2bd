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

import math
from dataclasses import dataclass

import numpy as np

from analysis.estimators.estimator import (
    MAX_GAP_S,
    KernelEstimator,
    KernelState,
    Prior,
    empty_estimates,
)
from analysis.samples.block import IMU, IMU_ID, Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    euler_of_quaternion,
    quaternion_of_euler,
    rotation_matrix,
)

Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]
NINE, BEFORE = 4, 13  # offsets in x (19,), after q_nb: the nine states, the last IMU sample
MIN_COS_PITCH = 1e-6  # keeps the Euler rates finite at a pitch of 90 degrees


@inlined
def state_derivative(x: Nine, gyro: Three, accel: Three) -> Nine:
    """The right-hand side, gyro in rad/s, accel in m/s^2."""
    roll, pitch, yaw, u, v, w, _, _, _ = x
    sf, cf = math.sin(roll), math.cos(roll)
    st, ct = math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(yaw), math.cos(yaw)
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
    kind: Indices, t_us: Stamps, values: Vector, state: KernelState, _: None
) -> tuple[Stamps, Vector, KernelState]:
    """Integrate over a block (see `analysis.samples.block`).

    The IMU sample before the block is NaN where it is unknown. Returns stamps (m,) and q_nb (m, 4)
    after each IMU sample, then the state.
    """
    when, q_nb = empty_estimates(kind)
    x, stamps = state.x.copy(), state.stamps.copy()
    done = 0
    for i in range(len(kind)):
        if kind[i] != IMU:
            continue
        v = values[i, :IMU_ID]
        # The first sample also serves as the previous one: a single Euler step.
        before = v if np.isnan(x[BEFORE]) else x[BEFORE:]
        dt_s = (t_us[i] - stamps[0]) * 1e-6
        if 0.0 < dt_s <= MAX_GAP_S:
            start = (x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
            after = heun_step(start, imu_sample(before), imu_sample(v), dt_s)
            x[NINE:BEFORE] = np.array(after)
        x[BEFORE:], stamps[0] = v, max(t_us[i], stamps[0])
        x[:NINE] = quaternion_of_euler(x[NINE], x[NINE + 1], x[NINE + 2])
        when[done] = stamps[0]
        for k in range(NINE):
            q_nb[done, k] = x[k]
        done += 1
    return when, q_nb, KernelState(x, stamps, state.airspeed_mps, state.declination_rad)


@dataclass(frozen=True)
class InverseModel(KernelEstimator):
    """Dead reckoning from the prior, without parameters."""

    tuning: None = None
    filter_block = staticmethod(integrate_block)

    def start(self, prior: Prior) -> KernelState:
        """The prior as Euler angles, body velocity and position."""
        nine = (
            euler_of_quaternion(prior.q_nb),
            rotation_matrix(prior.q_nb).T @ prior.v_ned_mps,
            prior.r_ned_m,
        )
        x = np.concatenate([prior.q_nb, *nine, np.full(6, np.nan)])
        return KernelState(x, np.array([prior.t_us]), 0.0, 0.0)
