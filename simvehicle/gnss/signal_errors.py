"""Pseudorange error models: receiver clock, multipath, orbits, C/N0.

References
----------
.. [1] Two-state clock: Brown and Hwang, Introduction to Random Signals and Applied Kalman
   Filtering, 4th ed., section 9.3.
.. [2] Multipath by elevation: RTCA DO-229D, J.2.4 (airborne).
"""

import math

import msgspec
import numpy as np

from mavproxy_fault.numerics.arrays import Array
from simvehicle.gnss.gnss_config import ClockConfig

CN0_CORRELATION_S = 20.0  # correlation time of the C/N0 variation; chosen: that of multipath
SHORTEST_CORRELATION_S = 1e-9  # a process with correlation time 0 becomes white noise
CLOCK_JUMP_S = 1e-3  # the receiver steps its clock by 1 ms when it is half of that off


class ReceiverClock(msgspec.Struct, frozen=True):
    """Receiver clock minus GPS time, and its rate."""

    offset_s: float
    drift: float


def step_clock(
    clock: ReceiverClock, config: ClockConfig, step_s: float, draws: Array
) -> ReceiverClock:
    """Propagate the clock by `step_s` [1]_; `draws` (2,) are standard normal."""
    q_offset, q_drift = config.h0_s / 2.0, 2.0 * math.pi**2 * config.h2_hz
    # Cholesky factor of [[q_o T + q_d T^3/3, q_d T^2/2], [., q_d T]], from the second row
    drift_kick = math.sqrt(q_drift * step_s) * draws[0]
    # Variance of the second row that is independent of the first draw.
    free = q_offset * step_s + q_drift * step_s**3 / 12.0
    offset_kick = drift_kick * step_s / 2.0 + math.sqrt(free) * draws[1]
    offset_s = clock.offset_s + clock.drift * step_s + offset_kick
    return ReceiverClock(
        float(offset_s - round(offset_s / CLOCK_JUMP_S) * CLOCK_JUMP_S),
        float(clock.drift + drift_kick),
    )


def step_gauss_markov(value: Array, time_s: float | Array, step_s: float, draws: Array) -> Array:
    """Propagate Gauss-Markov processes (n,) of unit variance and correlation time `time_s` by
    `step_s`; `draws` (n,) are standard normal."""
    # Clipped, as a correlation time of 0 means white noise.
    phi = np.exp(-step_s / np.maximum(time_s, SHORTEST_CORRELATION_S))
    return np.asarray(phi * value + np.sqrt(1.0 - phi * phi) * draws)


def multipath_sigma_m(elevation_rad: Array) -> Array:
    """Standard deviation of multipath [m] [2]_; a scalar or (n,) as the elevation."""
    sigma: Array = 0.13 + 0.53 * np.exp(-np.degrees(elevation_rad) / 10.0)
    return sigma
