"""Runs the filters of `analysis.estimators` on lanes, with their own scalar kernels.

One lane at a time, without SIMD, so that the estimator behaves in a search as it does elsewhere.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.estimators import complementary, ekf_kernel
from analysis.estimators.complementary import SIZE, Gains
from analysis.estimators.ekf_kernel import Tuning
from analysis.samples.block import FORCE, IMU_ID
from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, gather
from mavproxy_fault.numerics.compile import compiled

L = rows.LANES
M, Q = rows.MEASURED * L, rows.QUATERNION * L
FIELD, VELOCITY = rows.FIELD * L, rows.VELOCITY * L
ALIVE = rows.ALIVE * L
MAHONY, EKF = 1, 2  # kinds; 0 is the inverse sensor model
# Behind the longest state x: when GPS came, when gravity was used.
HEARD, LEVELLED, FILTER_SIZE = 91, 92, 93
ROUNDING_S = 1e-9
FilterStates = NDArray[np.float64]  # (LANES, FILTER_SIZE)


class Tunings(NamedTuple):
    """The tuning of Mahony's filter and the EKF; only that of the filter in use is read."""

    mahony: Gains
    ekf: Tuning


@compiled
def filter_step(buf: Buffer, filters: FilterStates, airspeed: Buffer, k: int, plan: Any) -> None:
    """The filters' share of sample `k` > 0 of every living lane, by a `search_kernel.Plan`.

    IMU, field, gravity where there has been no GPS for long, and GPS velocity, NaN where it never
    came.
    """
    gains, tuning = plan.tunings
    t_s, room = k * plan.dt_s, ekf_kernel.new_workspace()
    heads, moves = k % plan.field_every == 0, k % plan.velocity_every == 0
    for lane in range(L):
        if buf[ALIVE + lane] < 0.5:
            continue
        x, imu = filters[lane], gather(buf, M, IMU_ID, lane)
        field = gather(buf, FIELD, 3, lane) if heads else imu
        if plan.estimator == MAHONY:
            x[:SIZE] = complementary.predict(
                x[:SIZE], imu[:FORCE], imu[FORCE:], airspeed[lane], plan.dt_s, gains
            )
            if heads:
                x[:SIZE] = complementary.correct_heading(
                    x[:SIZE], field, plan.declination_rad, plan.field_every * plan.dt_s, gains
                )
            continue
        ekf_kernel.predict(x, imu, plan.dt_s, tuning, room)
        blind = t_s - x[HEARD] >= tuning.gps_timeout_s - ROUNDING_S
        if blind and t_s - x[LEVELLED] >= tuning.gravity_period_s - ROUNDING_S:
            ekf_kernel.correct_tilt(x, imu, airspeed[lane], tuning.gravity_variance, room)
            x[LEVELLED] = t_s
        if heads:
            variance = tuning.heading_variance
            ekf_kernel.correct_heading(x, field, plan.declination_rad, variance, room)
        seen = gather(buf, VELOCITY, 3, lane)
        if moves and seen[0] == seen[0]:
            if t_s - x[HEARD] >= tuning.gps_timeout_s:
                ekf_kernel.restart_velocity(x, seen, tuning.velocity_variance)
            else:
                ekf_kernel.correct_velocity(x, seen, tuning.velocity_variance, room)
            x[HEARD] = t_s


@compiled
def publish(buf: Buffer, filters: FilterStates) -> None:
    """QUATERNION from the estimators' states."""
    for lane in range(L):
        for i in range(4):
            buf[Q + i * L + lane] = filters[lane, i]
