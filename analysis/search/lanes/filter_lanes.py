"""The filters of `analysis.estimators` over lanes, by their own scalar kernels.

A lane at a time, without SIMD: what the search finds is what the estimator does elsewhere.
"""

import numpy as np
from numpy.typing import NDArray

from analysis.estimators import complementary, ekf_kernel
from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer
from mavproxy_fault.numerics.compile import compiled

L = rows.LANES
M, Q = rows.MEASURED * L, rows.QUATERNION * L
ALIVE = rows.ALIVE * L
MAHONY, EKF = 1, 2  # kinds; 0 is the inverse sensor model
HEARD, LEVELLED, FILTER_SIZE = (
    91,
    92,
    93,
)  # behind the longest state x, when GPS came, gravity was used
ROUNDING_S = 1e-9
FilterStates = NDArray[np.float64]  # (LANES, FILTER_SIZE)
Gains = tuple[float, float, float, float, float, float, float, float]


@compiled
def channels(buf: Buffer, row: int, count: int, lane: int) -> Buffer:
    """So many measured channels (count,) from the offset `row` on."""
    out = np.empty(count)
    for i in range(count):
        out[i] = buf[row + i * L + lane]
    return out


@compiled
def predict(
    buf: Buffer, filters: FilterStates, airspeed: Buffer, kind: int, gains: Gains, dt: float
) -> None:
    """Every living lane's estimate after its IMU sample."""
    room = ekf_kernel.new_room()
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            imu = channels(buf, M, 6, lane)
            if kind == MAHONY:
                x = filters[lane, :7]
                filters[lane, :7] = complementary.predict(
                    x, imu[:3], imu[3:], airspeed[lane], dt, gains[0], gains[2]
                )
            else:
                ekf_kernel.predict(filters[lane], imu, dt, gains[0], gains[1], gains[2], room)


@compiled
def head(
    buf: Buffer, filters: FilterStates, kind: int, gains: Gains, declination_rad: float, dt: float
) -> None:
    """Every living lane's estimate after its field sample, `dt` after the one before."""
    room = ekf_kernel.new_room()
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            field = channels(buf, M + 6 * L, 3, lane)
            if kind == MAHONY:
                x = filters[lane, :7]
                filters[lane, :7] = complementary.head(
                    x, field, declination_rad, dt, gains[1], gains[2]
                )
            else:
                ekf_kernel.head(filters[lane], field, declination_rad, gains[4], room)


@compiled
def velocity(buf: Buffer, filters: FilterStates, gains: Gains, t_s: float) -> None:
    """Every living lane's EKF after its GPS velocity; one that is NaN never came."""
    room = ekf_kernel.new_room()
    for lane in range(L):
        seen = channels(buf, M + 9 * L, 3, lane)
        if buf[ALIVE + lane] > 0.5 and seen[0] == seen[0]:
            if t_s - filters[lane, HEARD] >= gains[7]:
                ekf_kernel.restart_velocity(filters[lane], seen, gains[3])
            else:
                ekf_kernel.correct_velocity(filters[lane], seen, gains[3], room)
            filters[lane, HEARD] = t_s


@compiled
def level(buf: Buffer, filters: FilterStates, airspeed: Buffer, gains: Gains, t_s: float) -> None:
    """Gravity for every living lane's EKF that has been without GPS for long."""
    room = ekf_kernel.new_room()
    for lane in range(L):
        blind = t_s - filters[lane, HEARD] >= gains[7] - ROUNDING_S
        due = t_s - filters[lane, LEVELLED] >= gains[6] - ROUNDING_S
        if buf[ALIVE + lane] > 0.5 and blind and due:
            imu = channels(buf, M, 6, lane)
            ekf_kernel.level(filters[lane], imu, airspeed[lane], gains[5], room)
            filters[lane, LEVELLED] = t_s


@compiled
def publish(buf: Buffer, filters: FilterStates) -> None:
    """QUATERNION from the estimators' states."""
    for lane in range(L):
        for i in range(4):
            buf[Q + i * L + lane] = filters[lane, i]
