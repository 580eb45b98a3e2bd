"""The inverse-sensor-model estimator over lanes, by its own step."""

from analysis.estimators.inverse_model import heun_step
from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, Three, put_three, three_at
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotations.rotation_lanes import quaternion_of_euler

L = rows.LANES
ANGLES = rows.ESTIMATE * L
VELOCITY, POSITION = ANGLES + 3 * L, ANGLES + 6 * L
M = rows.MEASURED * L
ACCEL = (rows.ACCEL - rows.MEASURED) * L  # in a sample, behind the rates
B = rows.BEFORE * L
Q = rows.QUATERNION * L


@inlined
def imu_at(buf: Buffer, row: int, lane: int) -> tuple[Three, Three]:
    """Rates and specific force of a sample that begins at the offset `row`."""
    return three_at(buf, row, lane), three_at(buf, row + ACCEL, lane)


@compiled
def heun(buf: Buffer, dt: float) -> None:
    """One Heun step from the previous samples (rows BEFORE) to the current ones (rows MEASURED)."""
    wide()
    for lane in range(L):
        before, after = imu_at(buf, B, lane), imu_at(buf, M, lane)
        motion = three_at(buf, ANGLES, lane) + three_at(buf, VELOCITY, lane)
        x = heun_step(motion + three_at(buf, POSITION, lane), before, after, dt)
        put_three(buf, ANGLES, lane, x[:3])
        put_three(buf, VELOCITY, lane, x[3:6])
        put_three(buf, POSITION, lane, x[6:])


@compiled
def attitudes(buf: Buffer) -> None:
    """QUATERNION from the Euler angles of ESTIMATE."""
    wide()
    for lane in range(L):
        roll, pitch, yaw = three_at(buf, ANGLES, lane)
        e0, e1, e2, buf[Q + 3 * L + lane] = quaternion_of_euler(roll, pitch, yaw)
        put_three(buf, Q, lane, (e0, e1, e2))


@compiled
def keep(buf: Buffer) -> None:
    """The samples just used become those before."""
    for i in range(2 * ACCEL):
        buf[B + i] = buf[M + i]
