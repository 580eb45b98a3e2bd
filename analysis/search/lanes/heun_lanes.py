"""The inverse-sensor-model estimator over lanes: the same equations as `InverseModel`."""

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.polynomial import sin_cos
from mavproxy_fault.numerics.rotations.rotation_lanes import quaternion_of_euler

L = rows.LANES
ANGLES = rows.ESTIMATE * L
VELOCITY, POSITION = ANGLES + 3 * L, ANGLES + 6 * L
M = rows.MEASURED * L
ACCEL = (rows.ACCEL - rows.MEASURED) * L  # in a sample, behind the rates
B = rows.BEFORE * L
Q = rows.QUATERNION * L
MIN_COS_PITCH = 1e-6  # as in `analysis.estimators.inverse_model`

Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]


@inlined
def slope(x: Nine, gyro: Three, accel: Three, gravity: float) -> Nine:
    """The right-hand side; x is roll, pitch, yaw, u, v, w, north, east, down."""
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
        accel[0] + r * v - q * w - gravity * st,
        accel[1] + p * w - r * u + gravity * ct * sf,
        accel[2] + q * u - p * v + gravity * ct * cf,
        ct * cy * u + (sf * st * cy - cf * sy) * v + (cf * st * cy + sf * sy) * w,
        ct * sy * u + (sf * st * sy + cf * cy) * v + (cf * st * sy - sf * cy) * w,
        -st * u + sf * ct * v + cf * ct * w,
    )


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
def along(x: Nine, slope_: Nine, dt: float) -> Nine:
    """x + dt slope."""
    # Written out, as a loop over a tuple would keep LLVM from making SIMD code of it.
    roll, pitch, yaw, u, v, w, north, east, down = x
    d_roll, d_pitch, d_yaw, du, dv, dw, dn, de, dd = slope_
    return (
        roll + dt * d_roll,
        pitch + dt * d_pitch,
        yaw + dt * d_yaw,
        u + dt * du,
        v + dt * dv,
        w + dt * dw,
        north + dt * dn,
        east + dt * de,
        down + dt * dd,
    )


@inlined
def total(a: Nine, b: Nine) -> Nine:
    """a + b, component by component."""
    return along(a, b, 1.0)


@inlined
def imu_at(buf: Buffer, row: int, lane: int) -> tuple[Three, Three]:
    """Rates and specific force of a sample that begins at the offset `row`."""
    gyro = (buf[row + lane], buf[row + L + lane], buf[row + 2 * L + lane])
    force = row + ACCEL
    return gyro, (buf[force + lane], buf[force + L + lane], buf[force + 2 * L + lane])


@compiled
def heun(buf: Buffer, dt: float, gravity: float) -> None:
    """One step from the samples BEFORE to the samples MEASURED."""
    wide()
    for lane in range(L):
        x = estimate_at(buf, lane)
        gyro0, accel0 = imu_at(buf, B, lane)
        gyro1, accel1 = imu_at(buf, M, lane)
        first = slope(x, gyro0, accel0, gravity)
        second = slope(along(x, first, dt), gyro1, accel1, gravity)
        half = 0.5 * dt
        roll, pitch, yaw, u, v, w, north, east, down = along(x, total(first, second), half)
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
