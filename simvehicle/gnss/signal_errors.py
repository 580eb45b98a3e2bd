"""What a pseudorange is wrong by: receiver clock, thermal noise, multipath, orbits, C/N0.

References
----------
.. [1] Clock of two states: Brown and Hwang, Introduction to Random Signals and Applied Kalman
   Filtering, 4th ed., section 9.3.
.. [2] Code noise of a delay-locked and frequency noise of a frequency-locked loop: Kaplan and
   Hegarty, Understanding GPS/GNSS, 3rd ed., section 8.9; without their squaring loss.
.. [3] Multipath by elevation: RTCA DO-229D, J.2.4 (airborne).
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from simvehicle.gnss.gnss_config import ClockConfig

Vector = NDArray[np.float64]

# The C/A code's rate; E1's is the same.
CHIP_M = SPEED_OF_LIGHT_MPS / 1.023e6
L1_WAVE_M = SPEED_OF_LIGHT_MPS / L1_HZ
CORRELATOR_CHIPS = 0.1  # early to late
CODE_LOOP_HZ = 0.25  # aided by the carrier
FREQUENCY_LOOP_HZ = 2.0
INTEGRATION_S = 0.02
CN0_S = 20.0  # correlation time
TINY_S = 1e-9  # a process without a correlation time is white
JUMP_S = 1e-3  # the clock is set back by a millisecond when it is half of one out


class Clock(msgspec.Struct, frozen=True):
    """Receiver clock minus GPS time, and its rate."""

    offset_s: float
    drift: float


def next_clock(clock: Clock, config: ClockConfig, step_s: float, draws: Vector) -> Clock:
    """The clock `step_s` later [1]_; `draws` (2,) are standard normal."""
    q_offset, q_drift = config.h0_s / 2.0, 2.0 * math.pi**2 * config.h2_hz
    # Cholesky factor of [[q_o T + q_d T^3/3, q_d T^2/2], [., q_d T]], from the second row
    drift_kick = math.sqrt(q_drift * step_s) * draws[0]
    # What the second row has of its own, after its share of the first draw.
    free = q_offset * step_s + q_drift * step_s**3 / 12.0
    offset_kick = drift_kick * step_s / 2.0 + math.sqrt(free) * draws[1]
    offset_s = clock.offset_s + clock.drift * step_s + offset_kick
    return Clock(
        float(offset_s - round(offset_s / JUMP_S) * JUMP_S), float(clock.drift + drift_kick)
    )


def next_wander(value: Vector, time_s: float | Vector, step_s: float, draws: Vector) -> Vector:
    """Gauss-Markov processes (n,) of unit variance and correlation time `time_s`, `step_s` later;
    `draws` (n,) are standard normal."""
    # Clipped, since a correlation time of 0 means white noise, not a division by it.
    phi = np.exp(-step_s / np.maximum(time_s, TINY_S))
    return np.asarray(phi * value + np.sqrt(1.0 - phi * phi) * draws)


def multipath_sigma_m(elevation_rad: Vector) -> Vector:
    """Standard deviation (n,) of multipath [3]_; scalars and arrays (n,) alike, here and below."""
    sigma: Vector = 0.13 + 0.53 * np.exp(-np.degrees(elevation_rad) / 10.0)
    return sigma


def code_sigma_m(cn0_dbhz: Vector) -> Vector:
    """Thermal noise (n,) of the pseudorange [2]_."""
    ratio = 10.0 ** (cn0_dbhz / 10.0)
    # Grows with the correlators' spacing and the loop's bandwidth, falls with the signal.
    sigma: Vector = CHIP_M * np.sqrt(CORRELATOR_CHIPS * CODE_LOOP_HZ / (2.0 * ratio))
    return sigma


def rate_sigma_mps(cn0_dbhz: Vector) -> Vector:
    """Thermal noise (n,) of the range rate [2]_."""
    ratio = 10.0 ** (cn0_dbhz / 10.0)
    scale = L1_WAVE_M / (2.0 * math.pi * INTEGRATION_S)
    sigma: Vector = scale * np.sqrt(4.0 * FREQUENCY_LOOP_HZ / ratio)
    return sigma
