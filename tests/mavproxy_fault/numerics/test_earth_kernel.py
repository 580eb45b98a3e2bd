"""Comparison of the compiled coordinates with those of `earth`."""

import numpy as np
import pytest

from mavproxy_fault.numerics import earth, earth_kernel


@pytest.mark.parametrize("lat", [-1.5, -0.3, 0.0, 0.8, np.pi / 2])
@pytest.mark.parametrize("lon", [-3.0, 0.0, 0.2, 2.0])
def test_a_position_is_the_same_compiled(lat: float, lon: float) -> None:
    r = earth.ecef_from_geodetic(lat, lon, 480.0)
    assert np.allclose(earth_kernel.geodetic_position(r), earth.geodetic_from_ecef(r), rtol=1e-14)
    assert np.allclose(earth_kernel.ned_axes(lat, lon), earth.rot_en(lat, lon).T, atol=1e-15)
