"""Comparison of WGS 84 with published values, and with its inverse."""

import numpy as np
import pytest

from mavproxy_fault.numerics import earth


def test_known_points_of_the_ellipsoid() -> None:
    assert np.allclose(earth.ecef_from_geodetic(0.0, 0.0, 0.0), [6378137.0, 0.0, 0.0])
    pole = earth.ecef_from_geodetic(np.pi / 2, 0.0, 0.0)
    assert pole[2] == pytest.approx(6356752.3142, abs=1e-4)  # NGA.STND.0036, table 3.4


def test_geodetic_coordinates_there_and_back() -> None:
    rng = np.random.default_rng(1)
    lat, lon = rng.uniform(-np.pi / 2, np.pi / 2, 500), rng.uniform(-np.pi, np.pi, 500)
    height = rng.uniform(-500.0, 30000.0, 500)
    back = earth.geodetic_from_ecef(earth.ecef_from_geodetic(lat, lon, height))
    assert np.allclose(back[0], lat, atol=1e-14)
    assert np.allclose(back[1], lon, atol=1e-14)
    assert np.allclose(back[2], height, atol=5e-9)


@pytest.mark.parametrize("lat", [-np.pi / 2, 0.0, np.pi / 2])
def test_poles_and_equator_are_no_special_case(lat: float) -> None:
    back = earth.geodetic_from_ecef(earth.ecef_from_geodetic(lat, 0.3, 100.0))
    assert back[0] == pytest.approx(lat, abs=1e-12)
    assert back[2] == pytest.approx(100.0, abs=1e-8)


def test_gravity_at_equator_and_pole() -> None:
    # NGA.STND.0036, table 3.6: normal gravity at the equator and at the pole.
    assert earth.gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.gravity(np.pi / 2, 0.0) == pytest.approx(9.8321849379, abs=1e-9)


def test_gravity_falls_by_three_microgal_per_centimetre() -> None:
    drop = earth.gravity(0.8, 0.0) - earth.gravity(0.8, 1000.0)
    assert drop == pytest.approx(3.086e-3, rel=1e-3)  # the free-air gradient, 0.3086 mGal/m


def test_local_axes_are_the_derivatives_of_position() -> None:
    lat, lon, height, step = 0.8, 0.2, 500.0, 1e-7
    meridian, prime = earth.curvature_radii(lat)
    origin = earth.ecef_from_geodetic(lat, lon, height)
    north = (earth.ecef_from_geodetic(lat + step, lon, height) - origin) / step
    east = (earth.ecef_from_geodetic(lat, lon + step, height) - origin) / step
    down = origin - earth.ecef_from_geodetic(lat, lon, height + 1.0)
    rot = earth.rot_en(lat, lon)
    assert np.allclose(north / (meridian + height), rot[:, 0], atol=1e-6)
    assert np.allclose(east / ((prime + height) * np.cos(lat)), rot[:, 1], atol=1e-6)
    assert np.allclose(down, rot[:, 2], atol=1e-8)


def test_local_axes_of_many_points_at_once() -> None:
    assert earth.rot_en(np.zeros((4, 2)), np.zeros((4, 2))).shape == (4, 2, 3, 3)
