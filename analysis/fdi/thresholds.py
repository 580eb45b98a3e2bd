"""Chi-square and normal thresholds, kept once computed, and the probability of a statistic."""

import math
from functools import lru_cache
from math import comb

from scipy.special import chdtri, ndtri

from mavproxy_fault.wire.compiled import compiled


@lru_cache(maxsize=4096)
def chi_square(dof: int, p_false_alarm: float) -> float:
    """The value a chi-square variable of `dof` exceeds with probability `p_false_alarm`."""
    return float(chdtri(dof, p_false_alarm))


@lru_cache(maxsize=4096)
def subset_threshold(count: int, left_out: int, p_false_alarm: float, unknowns: int = 0) -> float:
    """Threshold of one leave-out test of `count` measurements that also solve for `unknowns`.

    The false-alarm probability is shared among all tests with as many left out, so that the right
    one passes with the configured probability whichever it is.
    """
    return chi_square(count - unknowns - left_out, p_false_alarm / comb(count, left_out))


@lru_cache(maxsize=1024)
def two_sided(p_false_alarm: float) -> float:
    """The value a standard normal variable exceeds in size with probability `p_false_alarm`."""
    return float(-ndtri(0.5 * p_false_alarm))


@compiled
def p_value(statistic: float, dof: int) -> float:
    """Probability of a statistic at least as large without a fault.

    The finite sums for whole degrees of freedom (Abramowitz and Stegun, 26.4.4 and 26.4.5).
    """
    statistic = max(statistic, 0.0)  # less by rounding only
    half, total = 0.5 * statistic, 0.0
    if dof % 2 == 0:
        term = 1.0
        for k in range(dof // 2):
            total += term
            term *= half / (k + 1.0)
        return total * math.exp(-half)
    term = math.sqrt(statistic)
    for k in range(dof // 2):
        total += term
        term *= statistic / (2.0 * k + 3.0)
    return math.erfc(math.sqrt(half)) + math.sqrt(2.0 / math.pi) * math.exp(-half) * total
