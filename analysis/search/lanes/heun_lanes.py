"""The inverse-sensor-model estimator over lanes, by its own step."""

from analysis.estimators.inverse_model import Nine, Three, heun_step
from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer
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
def estimate_at(buf: Buffer, lane: int) -> Nine:
    """The estimate of one lane before the step."""
    return (
        buf[ANGLES + lane],
        buf[ANGLES + L + lane],
        buf[ANGLES + 2 * L + lane],
        buf[VELOCITY + lane],
        buf[VELOCITY + L + lane],
        buf[VELOCITY + 2 * L + lane],
        buf[POSITION + lane],
        buf[POSITION + L + lane],
        buf[POSITION + 2 * L + lane],
    )


@inlined
def imu_at(buf: Buffer, row: int, lane: int) -> tuple[Three, Three]:
    """Rates and specific force of a sample that begins at the offset `row`."""
    gyro = (buf[row + lane], buf[row + L + lane], buf[row + 2 * L + lane])
    force = row + ACCEL
    return gyro, (buf[force + lane], buf[force + L + lane], buf[force + 2 * L + lane])


@compiled
def heun(buf: Buffer, dt: float) -> None:
    """One step from the samples BEFORE to the samples MEASURED."""
    wide()
    for lane in range(L):
        x = estimate_at(buf, lane)
        before, after = imu_at(buf, B, lane), imu_at(buf, M, lane)
        roll, pitch, yaw, u, v, w, north, east, down = heun_step(x, before, after, dt)
        buf[ANGLES + lane], buf[ANGLES + L + lane], buf[ANGLES + 2 * L + lane] = roll, pitch, yaw
        buf[VELOCITY + lane], buf[VELOCITY + L + lane], buf[VELOCITY + 2 * L + lane] = u, v, w
        buf[POSITION + lane], buf[POSITION + L + lane] = north, east
        buf[POSITION + 2 * L + lane] = down


@compiled
def attitudes(buf: Buffer) -> None:
    """QUATERNION from the Euler angles of ESTIMATE."""
    wide()
    for lane in range(L):
        roll, pitch, yaw = buf[ANGLES + lane], buf[ANGLES + L + lane], buf[ANGLES + 2 * L + lane]
        e0, e1, e2, e3 = quaternion_of_euler(roll, pitch, yaw)
        buf[Q + lane], buf[Q + L + lane] = e0, e1
        buf[Q + 2 * L + lane], buf[Q + 3 * L + lane] = e2, e3


@compiled
def keep(buf: Buffer) -> None:
    """The samples just used become those before."""
    for i in range(2 * ACCEL):
        buf[B + i] = buf[M + i]
