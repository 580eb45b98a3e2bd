"""Runs the filters of `analysis.estimators` on lanes, with their own scalar kernels.

One lane at a time, without SIMD, so that the estimator behaves in a search as it does elsewhere.
"""

from typing import NamedTuple

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
def predict(
    buf: Buffer, filters: FilterStates, airspeed: Buffer, kind: int, tunings: Tunings, dt: float
) -> None:
    """Every living lane's estimate after its IMU sample."""
    room = ekf_kernel.new_workspace()
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            imu = gather(buf, M, IMU_ID, lane)
            if kind == MAHONY:
                x = filters[lane, :SIZE]
                filters[lane, :SIZE] = complementary.predict(
                    x, imu[:FORCE], imu[FORCE:], airspeed[lane], dt, tunings.mahony
                )
            else:
                ekf_kernel.predict(filters[lane], imu, dt, tunings.ekf, room)


@compiled
def head(
    buf: Buffer,
    filters: FilterStates,
    kind: int,
    tunings: Tunings,
    declination_rad: float,
    dt: float,
) -> None:
    """Every living lane's estimate after its field sample, `dt` after the one before."""
    room, variance = ekf_kernel.new_workspace(), tunings.ekf.heading_variance
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            field = gather(buf, FIELD, 3, lane)
            if kind == MAHONY:
                x = filters[lane, :SIZE]
                filters[lane, :SIZE] = complementary.correct_heading(
                    x, field, declination_rad, dt, tunings.mahony
                )
            else:
                ekf_kernel.correct_heading(filters[lane], field, declination_rad, variance, room)


@compiled
def velocity(buf: Buffer, filters: FilterStates, tuning: Tuning, t_s: float) -> None:
    """Every living lane's EKF after its GPS velocity; one that is NaN never came."""
    room, variance = ekf_kernel.new_workspace(), tuning.velocity_variance
    for lane in range(L):
        seen = gather(buf, VELOCITY, 3, lane)
        if buf[ALIVE + lane] > 0.5 and seen[0] == seen[0]:
            if t_s - filters[lane, HEARD] >= tuning.gps_timeout_s:
                ekf_kernel.restart_velocity(filters[lane], seen, variance)
            else:
                ekf_kernel.correct_velocity(filters[lane], seen, variance, room)
            filters[lane, HEARD] = t_s


@compiled
def level(buf: Buffer, filters: FilterStates, airspeed: Buffer, tuning: Tuning, t_s: float) -> None:
    """Gravity for every living lane's EKF that has been without GPS for long."""
    room, variance = ekf_kernel.new_workspace(), tuning.gravity_variance
    for lane in range(L):
        blind = t_s - filters[lane, HEARD] >= tuning.gps_timeout_s - ROUNDING_S
        due = t_s - filters[lane, LEVELLED] >= tuning.gravity_period_s - ROUNDING_S
        if buf[ALIVE + lane] > 0.5 and blind and due:
            imu = gather(buf, M, IMU_ID, lane)
            ekf_kernel.correct_tilt(filters[lane], imu, airspeed[lane], variance, room)
            filters[lane, LEVELLED] = t_s


@compiled
def publish(buf: Buffer, filters: FilterStates) -> None:
    """QUATERNION from the estimators' states."""
    for lane in range(L):
        for i in range(4):
            buf[Q + i * L + lane] = filters[lane, i]
