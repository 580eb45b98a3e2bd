"""Chi-square and normal thresholds, cached.

Whole degrees of freedom need no special functions: the tail of chi-square is a finite sum [1]_.
Loading those of scipy would take longer than all thresholds of a flight.

References
----------
.. [1] Abramowitz and Stegun, Handbook of Mathematical Functions, 26.4.4 and 26.4.5.
"""

from functools import lru_cache
from math import erfc, exp, inf, lgamma, log, nan, pi, sqrt
from statistics import NormalDist

LARGEST_STATISTIC = 1400.0  # exp(-1400 / 2) is near the smallest number
NEWTON_STEPS = 5  # three suffice for up to 200 degrees of freedom and p down to 1e-15


@lru_cache(maxsize=4096)
def chi_square_threshold(dof: int, p_false_alarm: float) -> float:
    """The value a chi-square variable of `dof` exceeds with probability `p_false_alarm`.

    Newton's method on the logarithm of the tail, from Wilson and Hilferty's cube; NaN without a
    degree of freedom.
    """
    if dof < 1:
        return nan
    spread = 2.0 / (9.0 * dof)
    # Wilson and Hilferty's cube is near enough for Newton to converge in a few steps.
    x = max(dof * (1.0 - spread + two_sided_bound(2.0 * p_false_alarm) * sqrt(spread)) ** 3, 1e-3)
    for _ in range(NEWTON_STEPS):
        tail = p_value(x, dof)
        density = exp((0.5 * dof - 1.0) * log(0.5 * x) - 0.5 * x - lgamma(0.5 * dof)) / 2.0
        step = tail / density * log(tail / p_false_alarm)
        # Never below half of it: a long step could leave the positive numbers.
        x = max(x + step, 0.5 * x)
    return x


@lru_cache(maxsize=1024)
def two_sided_bound(p_false_alarm: float) -> float:
    """The value a standard normal variable exceeds in size with probability `p_false_alarm`."""
    return -NormalDist().inv_cdf(0.5 * p_false_alarm)


def p_value(statistic: float, dof: int) -> float:
    """Probability of a statistic at least as large without a fault."""
    # `statistic != statistic` is NaN.
    if not 0.0 < statistic < inf or dof < 1:
        return nan if dof < 1 or statistic != statistic else float(statistic <= 0.0)
    if statistic > LARGEST_STATISTIC:
        return 0.0
    half = 0.5 * statistic
    odd = dof % 2 == 1
    # Even degrees are a sum of exponentials, odd ones add the normal tail.
    total = erfc(sqrt(half)) if odd else 0.0
    term = 2.0 * sqrt(half / pi) * exp(-half) if odd else exp(-half)
    order = 1.5 if odd else 1.0  # the next term is this one times half / order
    for _ in range(dof // 2):
        total += term
        term *= half / order
        order += 1.0
    return total
