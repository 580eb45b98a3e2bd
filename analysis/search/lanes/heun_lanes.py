"""The inverse-sensor-model estimator over lanes: the same equations as `InverseModel`."""

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.polynomial import sin_cos

L = rows.LANES
E = rows.ESTIMATE * L
M = rows.MEASURED * L
B = rows.BEFORE * L
Q = rows.QUATERNION * L
MIN_COS_PITCH = 1e-6  # as in `analysis.estimators.inverse_model`

Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]


@inlined
def slope(x: Nine, gyro: Three, accel: Three, gravity: float) -> Nine:
    """The right-hand side; x is roll, pitch, yaw, u, v, w, north, east, down."""
    sf, cf = sin_cos(x[0])
    st, ct = sin_cos(x[1])
    sy, cy = sin_cos(x[2])
    u, v, w = x[3], x[4], x[5]
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


@compiled
def heun(buf: Buffer, dt: float, gravity: float) -> None:
    """One step from the samples BEFORE to the samples MEASURED."""
    wide()
    for lane in range(L):
        x = (
            buf[E + lane],
            buf[E + L + lane],
            buf[E + 2 * L + lane],
            buf[E + 3 * L + lane],
            buf[E + 4 * L + lane],
            buf[E + 5 * L + lane],
            buf[E + 6 * L + lane],
            buf[E + 7 * L + lane],
            buf[E + 8 * L + lane],
        )
        gyro0 = (buf[B + lane], buf[B + L + lane], buf[B + 2 * L + lane])
        accel0 = (buf[B + 3 * L + lane], buf[B + 4 * L + lane], buf[B + 5 * L + lane])
        gyro1 = (buf[M + lane], buf[M + L + lane], buf[M + 2 * L + lane])
        accel1 = (buf[M + 3 * L + lane], buf[M + 4 * L + lane], buf[M + 5 * L + lane])
        k = slope(x, gyro0, accel0, gravity)
        ahead = (
            x[0] + dt * k[0],
            x[1] + dt * k[1],
            x[2] + dt * k[2],
            x[3] + dt * k[3],
            x[4] + dt * k[4],
            x[5] + dt * k[5],
            0.0,
            0.0,
            0.0,
        )
        n = slope(ahead, gyro1, accel1, gravity)
        half = 0.5 * dt
        buf[E + lane] = x[0] + half * (k[0] + n[0])
        buf[E + L + lane] = x[1] + half * (k[1] + n[1])
        buf[E + 2 * L + lane] = x[2] + half * (k[2] + n[2])
        buf[E + 3 * L + lane] = x[3] + half * (k[3] + n[3])
        buf[E + 4 * L + lane] = x[4] + half * (k[4] + n[4])
        buf[E + 5 * L + lane] = x[5] + half * (k[5] + n[5])
        buf[E + 6 * L + lane] = x[6] + half * (k[6] + n[6])
        buf[E + 7 * L + lane] = x[7] + half * (k[7] + n[7])
        buf[E + 8 * L + lane] = x[8] + half * (k[8] + n[8])


@compiled
def attitudes(buf: Buffer) -> None:
    """QUATERNION from the Euler angles of ESTIMATE."""
    wide()
    for lane in range(L):
        sr, cr = sin_cos(0.5 * buf[E + lane])
        sp, cp = sin_cos(0.5 * buf[E + L + lane])
        sy, cy = sin_cos(0.5 * buf[E + 2 * L + lane])
        buf[Q + lane] = cr * cp * cy + sr * sp * sy
        buf[Q + L + lane] = sr * cp * cy - cr * sp * sy
        buf[Q + 2 * L + lane] = cr * sp * cy + sr * cp * sy
        buf[Q + 3 * L + lane] = cr * cp * sy - sr * sp * cy


@compiled
def keep(buf: Buffer) -> None:
    """The samples just used become those before."""
    for i in range(6 * L):
        buf[B + i] = buf[M + i]
