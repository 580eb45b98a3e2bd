"""Comparison of the branch-free functions with the mathematics library."""

import math

import numpy as np

from mavproxy_fault.numerics import polynomial
from mavproxy_fault.numerics.compile import compiled

RNG = np.random.default_rng(3)


@compiled
def _all(x: float, y: float) -> tuple[float, float, float, float]:
    sine, cosine = polynomial.sin_cos(x)
    return sine, cosine, polynomial.exp(x), polynomial.atan2(y, x)


def test_polynomials_agree_with_the_math_library() -> None:
    for x, y in RNG.uniform(-50.0, 50.0, (2000, 2)):
        sine, cosine, power, angle = _all(x, y)
        assert abs(sine - math.sin(x)) < 1e-15
        assert abs(cosine - math.cos(x)) < 1e-15
        assert abs(power / math.exp(x) - 1.0) < 1e-15
        assert abs(angle - math.atan2(y, x)) < 1e-15


def test_the_axes_and_the_origin_are_no_special_case() -> None:
    for x, y in [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0)]:
        assert abs(_all(x, y)[3] - math.atan2(y, x)) < 1e-15
