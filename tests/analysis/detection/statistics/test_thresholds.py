"""Thresholds and probabilities against scipy's special functions."""

import math

import pytest
from scipy.special import chdtrc, chdtri, ndtri

from analysis.detection.statistics.chi_square import chi_square_threshold, p_value, two_sided_bound

PROBABILITIES = (0.4, 0.1, 1e-3, 1e-4, 1e-6, 1e-9, 1e-13)


@pytest.mark.parametrize("dof", [*range(1, 31), 40, 60])
def test_thresholds_and_probabilities_are_those_of_scipy(dof: int):
    for p in PROBABILITIES:
        assert chi_square_threshold(dof, p) == pytest.approx(chdtri(dof, p), rel=1e-12)
    for statistic in (1e-9, 0.02, 0.7, 3.0, 19.0, 80.0, 600.0, 1300.0):
        assert p_value(statistic, dof) == pytest.approx(chdtrc(dof, statistic), rel=1e-11)


@pytest.mark.parametrize("p", PROBABILITIES)
def test_the_normal_threshold_is_that_of_scipy(p: float):
    assert two_sided_bound(p) == pytest.approx(-ndtri(0.5 * p), rel=1e-13)


def test_statistics_at_the_ends_have_their_probabilities():
    assert (p_value(0.0, 5), p_value(-1.0, 5), p_value(1e300, 5)) == (1.0, 1.0, 0.0)
    assert p_value(math.inf, 4) == 0.0
    assert math.isnan(p_value(math.nan, 4))
    assert math.isnan(p_value(1.0, 0))
    assert math.isnan(chi_square_threshold(0, 1e-3))
