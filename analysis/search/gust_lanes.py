"""Dryden gusts over lanes, by the simulator's own filters, a lane at a time."""

import numpy as np

from analysis.search import rows
from analysis.search.lanes import Buffer, Three
from simvehicle.air import wind_step
from simvehicle.compiled import compiled
from simvehicle.vehicles.rigidbody_kernel import to_body

L = rows.LANES
S, W, N = rows.STATE * L, rows.WIND * L, rows.NOISE * L
G, T, ALIVE = rows.GUSTS * L, rows.STEADY * L, rows.ALIVE * L
NO_SHEAR = (1.0, 1.0, 0.0)


@compiled
def gather(buf: Buffer, first: int, count: int, lane: int) -> Buffer:
    """Some rows of one lane (count,) from the offset `first` on."""
    out = np.empty(count)
    for i in range(count):
        out[i] = buf[first + i * L + lane]
    return out


@compiled
def blow(buf: Buffer, sigma: Three, length: Three, dt: float) -> None:
    """WIND of the next step from the steady wind and noise numbers 0 to 4."""
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            steady, q = gather(buf, T, 3, lane), gather(buf, S + 6 * L, 4, lane)
            v, wind = gather(buf, S + 3 * L, 3, lane), gather(buf, W, 3, lane)
            x, y, z = to_body(q[0], q[1], q[2], q[3], wind[0], wind[1], wind[2])
            speed = np.sqrt((v[0] - x) ** 2 + (v[1] - y) ** 2 + (v[2] - z) ** 2)
            filters, blown = wind_step(
                gather(buf, G, 5, lane),
                gather(buf, N, 5, lane),
                steady,
                NO_SHEAR,
                q,
                speed,
                sigma,
                length,
                dt,
            )
            for i in range(5):
                buf[G + i * L + lane] = filters[i]
            for i in range(3):
                buf[W + i * L + lane] = blown[i]
