"""Comparison of the polynomials with the mathematics library."""

import math

import numpy as np

from mavproxy_fault.numerics import polynomial
from mavproxy_fault.numerics.compile import compiled

RNG = np.random.default_rng(3)


@compiled
def _both(x: float, y: float) -> tuple[float, float]:
    return polynomial.exp(x), polynomial.atan2(y, x)


def test_polynomials_agree_with_the_math_library() -> None:
    for x, y in RNG.uniform(-50.0, 50.0, (2000, 2)):
        power, angle = _both(x, y)
        assert abs(power / math.exp(x) - 1.0) < 1e-15
        assert abs(angle - math.atan2(y, x)) < 1e-15


def test_the_axes_and_the_origin_are_no_special_case() -> None:
    for x, y in [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0)]:
        assert abs(_both(x, y)[1] - math.atan2(y, x)) < 1e-15
