"""The filters of `analysis.estimators` over lanes, by their own scalar kernels.

A lane at a time, without SIMD: what the search finds is what the estimator does elsewhere.
"""

import numpy as np
from numpy.typing import NDArray

from analysis.estimators import complementary, ekf_kernel
from analysis.search import rows
from analysis.search.lanes import Buffer
from mavproxy_fault.wire.compiled import compiled

L = rows.LANES
M, Q = rows.MEASURED * L, rows.QUATERNION * L
ALIVE = rows.ALIVE * L
MAHONY, EKF = 1, 2  # kinds; 0 is the inverse sensor model
STATES = 91  # length of the longest estimator state x, the EKF's
HEARD, LEVELLED, MEMORY = 91, 92, 93  # when GPS was last heard, and gravity used
ROUNDING_S = 1e-9
Memory = NDArray[np.float64]  # (LANES, MEMORY)
Gains = tuple[float, float, float, float, float, float, float, float]


@compiled
def three(buf: Buffer, row: int, lane: int) -> Buffer:
    """Three measured channels (3,) from the offset `row` on."""
    out = np.empty(3)
    for i in range(3):
        out[i] = buf[row + i * L + lane]
    return out


@compiled
def predict(
    buf: Buffer, memory: Memory, airspeed: Buffer, kind: int, gains: Gains, dt: float
) -> None:
    """Every living lane's estimate after its IMU sample."""
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            gyro, accel = three(buf, M, lane), three(buf, M + 3 * L, lane)
            if kind == MAHONY:
                x = memory[lane, :7]
                memory[lane, :7] = complementary.predict(
                    x, gyro, accel, airspeed[lane], dt, gains[0], gains[2]
                )
            else:
                memory[lane, :STATES] = ekf_kernel.predict(
                    memory[lane, :STATES], gyro, accel, dt, gains[0], gains[1], gains[2]
                )


@compiled
def head(
    buf: Buffer, memory: Memory, kind: int, gains: Gains, declination_rad: float, dt: float
) -> None:
    """Every living lane's estimate after its field sample, `dt` after the one before."""
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            field = three(buf, M + 6 * L, lane)
            if kind == MAHONY:
                x = memory[lane, :7]
                memory[lane, :7] = complementary.head(
                    x, field, declination_rad, dt, gains[1], gains[2]
                )
            else:
                memory[lane, :STATES] = ekf_kernel.head(
                    memory[lane, :STATES], field, declination_rad, gains[4]
                )


@compiled
def velocity(buf: Buffer, memory: Memory, gains: Gains, t_s: float) -> None:
    """Every living lane's EKF after its GPS velocity; one that is NaN never came."""
    for lane in range(L):
        seen = three(buf, M + 9 * L, lane)
        if buf[ALIVE + lane] > 0.5 and seen[0] == seen[0]:
            if t_s - memory[lane, HEARD] >= gains[7]:
                memory[lane, :STATES] = ekf_kernel.restart_velocity(
                    memory[lane, :STATES], seen, gains[3]
                )
            else:
                memory[lane, :STATES] = ekf_kernel.correct_velocity(
                    memory[lane, :STATES], seen, gains[3]
                )
            memory[lane, HEARD] = t_s


@compiled
def level(buf: Buffer, memory: Memory, airspeed: Buffer, gains: Gains, t_s: float) -> None:
    """Gravity for every living lane's EKF that has been without GPS for long."""
    for lane in range(L):
        blind = t_s - memory[lane, HEARD] >= gains[7] - ROUNDING_S
        due = t_s - memory[lane, LEVELLED] >= gains[6] - ROUNDING_S
        if buf[ALIVE + lane] > 0.5 and blind and due:
            gyro, accel = three(buf, M, lane), three(buf, M + 3 * L, lane)
            memory[lane, :STATES] = ekf_kernel.level(
                memory[lane, :STATES], gyro, accel, airspeed[lane], gains[5]
            )
            memory[lane, LEVELLED] = t_s


@compiled
def publish(buf: Buffer, memory: Memory) -> None:
    """QUATERNION from the estimators' states."""
    for lane in range(L):
        for i in range(4):
            buf[Q + i * L + lane] = memory[lane, i]
