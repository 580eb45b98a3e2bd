"""The slower sensors over lanes: magnetic field, GPS velocity and differential pressure."""

import numpy as np

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import (
    NOW,
    Buffer,
    Three,
    air_velocity,
    put_three,
    three_at,
    true_attitude,
)
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned
from simvehicle.vehicles.rigidbody_kernel import U

L = rows.LANES
N = rows.NOISE * L
B, V, P = rows.FIELD * L, rows.VELOCITY * L, rows.DIFF_PRESSURE * L
BS, VS, PS = rows.FIELD_SIGMA * L, rows.VELOCITY_SIGMA * L, rows.PRESSURE_SIGMA * L


@compiled
def sense_field(buf: Buffer, field_ned: Three) -> None:
    """The field of the place in body axes with noise numbers 0 to 2."""
    for lane in range(L):
        e0, e1, e2, e3 = true_attitude(buf, lane)
        x, y, z = to_body(e0, e1, e2, e3, field_ned[0], field_ned[1], field_ned[2])
        sigma, (a, b, c) = buf[BS + lane], three_at(buf, N, lane)
        put_three(buf, B, lane, (x + sigma * a, y + sigma * b, z + sigma * c))


@compiled
def sense_velocity(buf: Buffer) -> None:
    """Velocity over ground, NED, with noise numbers 3 to 5."""
    for lane in range(L):
        e0, e1, e2, e3 = true_attitude(buf, lane)
        u, v, w = three_at(buf, NOW + U * L, lane)
        north, east, down = to_ned(e0, e1, e2, e3, u, v, w)
        sigma, (a, b, c) = buf[VS + lane], three_at(buf, N + 3 * L, lane)
        put_three(buf, V, lane, (north + sigma * a, east + sigma * b, down + sigma * c))


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
