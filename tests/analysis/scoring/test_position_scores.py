"""Percentiles of known errors."""

import numpy as np
import pytest

from analysis.scoring.position_scores import PositionScores
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes

LAT, LON = np.radians(47.0), np.radians(8.0)
TRUE_M = ecef_from_geodetic(LAT, LON, 500.0)


@pytest.fixture
def scores():
    """Errors of 1, 2, ..., 100 m north and twice that down, with a sigma of 10 m in all."""
    found = PositionScores()
    for size in range(1, 101):
        off = np.array([size, 0.0, 2.0 * size]) @ ned_axes(LAT, LON)
        found.add("filter", TRUE_M + off, (6.0, 0.0, 8.0), TRUE_M)
    return found


def test_percentiles_are_those_of_the_errors(scores):
    row = scores.summary()["filter"]
    assert row["epochs"] == 100
    assert row["horizontal_50_m"] == pytest.approx(50.5, abs=0.01)
    assert row["vertical_95_m"] == pytest.approx(2 * np.percentile(range(1, 101), 95), abs=0.01)
    assert row["horizontal_largest_m"] == pytest.approx(100.0, abs=0.01)
    assert row["over_sigma_50"] == pytest.approx(50.5 * 5**0.5 / 10.0, abs=0.01)


def test_the_rmse_is_of_the_length(scores):
    squares = np.mean(np.arange(1, 101) ** 2)
    assert scores.rmse_m("filter") == pytest.approx((5 * squares) ** 0.5, abs=0.01)
    assert scores.rmse_m("fused") is None


def test_without_a_sigma_its_share_is_unknown():
    found = PositionScores()
    found.add("filter", TRUE_M, None, TRUE_M)
    assert found.summary()["filter"]["over_sigma_95"] is None
