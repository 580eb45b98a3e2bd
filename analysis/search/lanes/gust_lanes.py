"""Dryden gusts over lanes, by the simulator's own filters, a lane at a time."""

import numpy as np

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, Three, gather
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from simvehicle.environment.air import LENGTH, REFERENCE, SIGMA, STEADY_WIND, step_wind
from simvehicle.vehicles.rigidbody_kernel import E0, E1, E2, E3, RIGID_SIZE, U

L = rows.LANES
S, W, N = rows.STATE * L, rows.WIND * L, rows.NOISE * L
G, T, ALIVE = rows.GUSTS * L, rows.STEADY * L, rows.ALIVE * L
ANY_HEIGHT_M = 1.0  # there is no shear


@compiled
def blow(buf: Buffer, sigma: Three, length: Three, dt: float) -> None:
    """WIND of the next step from the steady wind and noise numbers 0 to 4."""
    weather = np.zeros(11)  # as `step_wind` wants it
    for i in range(3):
        weather[SIGMA + i], weather[LENGTH + i] = sigma[i], length[i]
    weather[REFERENCE] = ANY_HEIGHT_M
    for lane in range(L):
        if buf[ALIVE + lane] > 0.5:
            filters, noise = gather(buf, G, 5, lane), gather(buf, N, 5, lane)
            weather[STEADY_WIND:], wind = gather(buf, T, 3, lane), gather(buf, W, 3, lane)
            x = gather(buf, S, RIGID_SIZE, lane)
            past = to_body(x[E0], x[E1], x[E2], x[E3], wind[0], wind[1], wind[2])
            v_air = np.empty(3)
            for i in range(3):
                v_air[i] = x[U + i] - past[i]
            step_wind(filters, noise, weather, x, v_air, ANY_HEIGHT_M, dt, wind)
            for i in range(5):
                buf[G + i * L + lane] = filters[i]
            for i in range(3):
                buf[W + i * L + lane] = wind[i]
