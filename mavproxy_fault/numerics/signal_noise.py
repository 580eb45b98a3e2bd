"""Thermal noise of a receiver's code and frequency loops as a function of C/N0.

References
----------
.. [1] Code noise of a delay-locked and frequency noise of a frequency-locked loop: Kaplan and
   Hegarty, Understanding GPS/GNSS, 3rd ed., section 8.9; without their squaring loss.
"""

import math

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS

# The code rate of C/A and E1.
CHIP_M = SPEED_OF_LIGHT_MPS / 1.023e6
L1_WAVE_M = SPEED_OF_LIGHT_MPS / L1_HZ
CORRELATOR_CHIPS = 0.1  # early-late spacing; with the bandwidths, chosen as usual values of [1]_
CODE_LOOP_HZ = 0.25  # carrier-aided
FREQUENCY_LOOP_HZ = 2.0
INTEGRATION_S = 0.02


def code_sigma_m(cn0_dbhz: Array) -> Array:
    """Return the thermal noise [m] of the pseudorange [1]_ for a C/N0 (scalar or (n,))."""
    ratio = 10.0 ** (cn0_dbhz / 10.0)
    sigma: Array = CHIP_M * np.sqrt(CORRELATOR_CHIPS * CODE_LOOP_HZ / (2.0 * ratio))
    return sigma


def rate_sigma_mps(cn0_dbhz: Array) -> Array:
    """Return the thermal noise [m/s] of the range rate [1]_ for a C/N0 (scalar or (n,))."""
    ratio = 10.0 ** (cn0_dbhz / 10.0)
    scale = L1_WAVE_M / (2.0 * math.pi * INTEGRATION_S)
    sigma: Array = scale * np.sqrt(4.0 * FREQUENCY_LOOP_HZ / ratio)
    return sigma
