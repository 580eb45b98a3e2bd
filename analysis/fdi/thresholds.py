"""Chi-square and normal thresholds, kept once computed."""

from functools import lru_cache
from math import comb

from scipy.special import chdtrc, chdtri, ndtri


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


def p_value(statistic: float, dof: int) -> float:
    """Probability of a statistic at least as large without a fault."""
    return float(chdtrc(dof, statistic))
