"""Delays of the atmosphere at places and times where they are known."""

import math

import numpy as np
import pytest

from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from simvehicle.gnss.signal_delays import (
    ionosphere_m,
    troposphere_m,
    zenith_delay_m,
)

UP = math.pi / 2.0
ALPHA_BETA = np.array([1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8, 90110.0, 0.0, -196600.0, -65540.0])


def test_the_zenith_delay_of_the_standard_atmosphere_is_two_and_a_half_metres() -> None:
    dry = 0.0022768 * 1013.25  # Davis et al. 1985, at 45 degrees
    assert zenith_delay_m(math.radians(45.0), 0.0) == pytest.approx(dry + 0.1, abs=0.02)
    assert zenith_delay_m(math.radians(45.0), 5000.0) == pytest.approx(1.25, abs=0.05)
    assert zenith_delay_m(0.7, 30e3) == zenith_delay_m(0.7, 11e3)


def test_the_slant_delay_grows_as_one_over_the_sine() -> None:
    zenith = troposphere_m(0.7, 100.0, UP)
    assert zenith == pytest.approx(zenith_delay_m(0.7, 100.0), rel=1e-3)
    assert troposphere_m(0.7, 100.0, math.radians(30.0)) == pytest.approx(2.0 * zenith, rel=5e-3)
    assert troposphere_m(0.7, 100.0, math.radians(5.0)) == pytest.approx(10.2 * zenith, rel=0.02)


def test_at_night_the_ionosphere_delays_by_five_nanoseconds() -> None:
    midnight_s = 15 * 3600.0  # at 135 degrees east
    delay = ionosphere_m(midnight_s, math.radians(35.0), math.radians(135.0), UP, 0.0, ALPHA_BETA)
    assert delay == pytest.approx(5e-9 * SPEED_OF_LIGHT_MPS, rel=1e-3)


def test_the_ionosphere_is_thickest_at_two_in_the_afternoon() -> None:
    place = (math.radians(35.0), math.radians(135.0))
    hours = np.arange(0.0, 24.0, 0.5)
    delays = [ionosphere_m((h - 9.0) % 24.0 * 3600.0, *place, UP, 0.0, ALPHA_BETA) for h in hours]
    assert hours[int(np.argmax(delays))] == pytest.approx(14.0, abs=0.5)


def test_amplitude_and_slant_follow_the_formula() -> None:
    # IS-GPS-200N figure 20-4, by hand at the equator, 0 degrees east, 14:00, elevation 90 degrees
    flat = np.array([1e-8, 0.0, 0.0, 0.0, 1e5, 0.0, 0.0, 0.0])
    slant = 1.0 + 16.0 * (0.53 - 0.5) ** 3
    delay = ionosphere_m(50_400.0, 0.0, 0.0, UP, 0.0, flat)
    assert delay == pytest.approx(SPEED_OF_LIGHT_MPS * slant * 1.5e-8, rel=1e-12)
    low = ionosphere_m(50_400.0, 0.0, 0.0, 0.0, 0.0, flat)
    assert low == pytest.approx(SPEED_OF_LIGHT_MPS * (1 + 16 * 0.53**3) * 1.5e-8, rel=1e-12)
