"""The slower sensors over lanes: magnetic field, GPS velocity and differential pressure."""

import numpy as np

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, air_velocity, true_attitude, true_velocity
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned

L = rows.LANES
N = rows.NOISE * L
B, V, P = rows.FIELD * L, rows.VELOCITY * L, rows.DIFF_PRESSURE * L
BS, VS, PS = rows.FIELD_SIGMA * L, rows.VELOCITY_SIGMA * L, rows.PRESSURE_SIGMA * L

Three = tuple[float, float, float]


@compiled
def sense_field(buf: Buffer, field_ned: Three) -> None:
    """The field of the place in body axes with noise numbers 0 to 2."""
    for lane in range(L):
        e0, e1, e2, e3 = true_attitude(buf, lane)
        x, y, z = to_body(e0, e1, e2, e3, field_ned[0], field_ned[1], field_ned[2])
        sigma = buf[BS + lane]
        buf[B + lane] = x + sigma * buf[N + lane]
        buf[B + L + lane] = y + sigma * buf[N + L + lane]
        buf[B + 2 * L + lane] = z + sigma * buf[N + 2 * L + lane]


@compiled
def sense_velocity(buf: Buffer) -> None:
    """Velocity over ground, NED, with noise numbers 3 to 5."""
    for lane in range(L):
        e0, e1, e2, e3 = true_attitude(buf, lane)
        u, v, w = true_velocity(buf, lane)
        north, east, down = to_ned(e0, e1, e2, e3, u, v, w)
        sigma = buf[VS + lane]
        buf[V + lane] = north + sigma * buf[N + 3 * L + lane]
        buf[V + L + lane] = east + sigma * buf[N + 4 * L + lane]
        buf[V + 2 * L + lane] = down + sigma * buf[N + 5 * L + lane]


@compiled
def sense_pressure(buf: Buffer, density: float) -> None:
    """Dynamic pressure of the air past the body with noise number 0."""
    for lane in range(L):
        u, v, w = air_velocity(buf, lane)
        square = u * u + v * v + w * w
        buf[P + lane] = 0.5 * density * square + buf[PS + lane] * buf[N + lane]


@compiled
def airspeeds(buf: Buffer, out: Buffer, density: float) -> None:
    """Equivalent airspeed (LANES,) that an estimator makes of the pressure."""
    for lane in range(L):
        pressure = buf[P + lane]
        out[lane] = np.sqrt(2.0 * (pressure if pressure > 0.0 else 0.0) / density)
