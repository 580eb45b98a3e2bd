"""Thermal noise by the textbook formulas."""

import math

import numpy as np
import pytest

from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.signal_noise import code_sigma_m, rate_sigma_mps


def test_thermal_noise_follows_carrier_to_noise() -> None:
    # CHIP sqrt(d B / (2 C/N0)) at 45 dBHz with d = 0.1, B = 0.25 Hz
    expected = SPEED_OF_LIGHT_MPS / 1.023e6 * math.sqrt(0.025 / (2.0 * 10**4.5))
    assert code_sigma_m(np.array([45.0, 25.0])) == pytest.approx([expected, 10.0 * expected])
    assert rate_sigma_mps(np.array([45.0]))[0] == pytest.approx(0.024, abs=0.001)
