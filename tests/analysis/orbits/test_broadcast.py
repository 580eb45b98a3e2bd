"""Orbits, clocks and atmosphere against the independent ones of the simulator and known values."""

import math

import numpy as np
import pytest

from analysis.orbits.broadcast import (
    TYPICAL_ALPHA,
    TYPICAL_BETA,
    klobuchar_m,
    pack_ephemeris,
    satellite_states,
    troposphere_m,
    zenith_delay_m,
)
from analysis.samples.sample import EphemerisSample, Epoch, Sample
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import geodetic_position
from simvehicle.gnss.signal_delays import ionosphere_m
from simvehicle.gnss.signal_delays import troposphere_m as simulated_troposphere_m
from tests.analysis.orbits.snapshot_solution import solve_position


def _first(samples: list[Sample]) -> tuple[Epoch, np.ndarray]:
    epoch = next(s for s in samples if isinstance(s, Epoch))
    known = {s.ephemeris.satellite: s.ephemeris for s in samples if isinstance(s, EphemerisSample)}
    return epoch, np.array([pack_ephemeris(known[name]) for name in epoch.satellites])


def test_the_velocity_of_a_satellite_is_the_derivative_of_its_position(flight):
    epoch, packed = _first(flight)
    before, now, after = (
        satellite_states(packed, epoch.week, epoch.tow_s + dt, epoch.pseudorange_m)
        for dt in (-0.5, 0.0, 0.5)
    )
    assert np.abs((after - before)[:, :3] - now[:, 3:6]).max() < 1e-3  # a/24 s^2: 25 um/s


def test_a_satellite_is_where_the_simulator_has_it(flight):
    epoch, packed = _first(flight)
    fix = solve_position(
        epoch, packed, np.array(TYPICAL_ALPHA + TYPICAL_BETA), np.ones(len(epoch.satellites))
    )
    truth = next(s for s in flight if type(s).__name__ == "TruthSample")
    r = ecef_from_geodetic(math.radians(truth.lat_deg), math.radians(truth.lon_deg), truth.alt_m)
    # 1 m orbit, multipath and noise times a dilution below 2, at five sigma
    assert fix is not None
    assert np.linalg.norm(fix.r_ecef_m - r) < 10.0
    assert fix.isb_m[0] == pytest.approx(1.5, abs=3.0)


@pytest.mark.parametrize("elevation_deg", [10.0, 35.0, 80.0])
@pytest.mark.parametrize("hour", [2.0, 14.0])
def test_the_atmosphere_agrees_with_the_simulator_s(elevation_deg: float, hour: float):
    el = math.radians(elevation_deg)
    coefficients = np.array(TYPICAL_ALPHA + TYPICAL_BETA)
    ours = klobuchar_m(0.8, 0.2, 1.0, el, hour * 3600.0, coefficients)
    theirs = ionosphere_m(hour * 3600.0, 0.8, 0.2, el, 1.0, coefficients)
    assert ours == pytest.approx(theirs, abs=1e-3)
    dry = troposphere_m(zenith_delay_m(0.8, 300.0), el)
    assert dry == pytest.approx(simulated_troposphere_m(0.8, 300.0, el), rel=0.01)


def test_the_zenith_delay_at_sea_level_is_about_two_metres_forty():
    assert 2.3 < troposphere_m(zenith_delay_m(0.8, 0.0), math.pi / 2) < 2.5  # Saastamoinen 1973


@pytest.mark.parametrize("lat", [-1.5, -0.3, 0.0, 0.9, 1.55])
def test_geodetic_undoes_ecef(lat: float):
    r = np.asarray(ecef_from_geodetic(lat, 2.0, 1234.5))
    back = geodetic_position(r)
    assert back == pytest.approx((lat, 2.0, 1234.5), abs=1e-4)
