"""Every test statistic of an epoch, before the filter uses it."""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.information import (
    NormalEquations,
    covariance_block,
    posterior_block,
    posterior_statistic,
    rate_equations,
)
from analysis.detection.filter.measurement import Innovations
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite

LEAST_RATES = 5  # four states and one to spare


class EpochStatistics(NamedTuple):
    """The tests of an epoch's trusted satellites (n,), before any verdict.

    `normalised` (n,) are the ranges' innovations as standard normal numbers.
    `q` is the ranges' statistic, `q_rate` that of the known Doppler rates, `parity` that of
    the snapshot's residuals with `parity_dof` degrees of freedom (0: no test); `systems` counts the
    systems in use. `ranges` and `rates` are the normal equations of both.
    """

    normalised: Vector
    q: float
    q_rate: float
    parity: float
    parity_dof: int
    systems: int
    ranges: NormalEquations
    rates: NormalEquations

    @property
    def rate_count(self) -> int:
        """How many Doppler rates are known."""
        return len(self.rates.v)


@compiled
def compute_statistics(
    innovations: Innovations, ranges: NormalEquations, p: Vector
) -> EpochStatistics:
    """Every test of n innovations, with their `ranges`, against a prediction with covariance p
    (20, 20)."""
    rates = rate_equations(innovations.geometry, innovations.rate_variance, innovations.rate_mps)
    fit = posterior_block(covariance_block(p, ranges.states), ranges)[0]
    fit_rates = posterior_block(covariance_block(p, rates.states), rates)[0]
    parity, dof, systems = parity_test(ranges)
    return EpochStatistics(
        normalise_innovations(ranges, fit),
        posterior_statistic(ranges, fit),
        posterior_statistic(rates, fit_rates),
        parity,
        dof,
        systems,
        ranges,
        rates,
    )


@compiled
def normalise_innovations(normal: NormalEquations, fit: Vector) -> Vector:
    """u_i / sqrt(M_ii) (n,), standard normal without faults, whose squares are what q loses
    without i; NaN where the others do not check a satellite. `fit` is F (c, c)."""
    a, variance, out = normal.a, normal.variance, np.empty(normal.v.shape[0])
    for i in range(out.shape[0]):
        remaining, own = normal.v[i], 1.0
        for j in range(a.shape[1]):
            for k in range(a.shape[1]):
                remaining -= a[i, j] * fit[j, k] * normal.b[k]
                own -= a[i, j] * fit[j, k] * a[i, k] / variance[i]
        # A satellite that alone sees a state fits it exactly: its residual says nothing.
        known = own > 1e-12 * variance[i]
        out[i] = remaining / math.sqrt(own * variance[i]) if known else np.nan
    return out


@compiled
def parity_test(normal: NormalEquations) -> tuple[float, int, int]:
    """The statistic of the snapshot's residuals, its degrees of freedom, and how many systems.

    A snapshot solves for the states that the ranges observe; without GPS the offset of the first
    system takes the place of the clock.
    """
    of_others, count = 0.0, normal.v.shape[0]
    for i in range(count):
        for j in range(4, normal.a.shape[1]):
            of_others += normal.a[i, j]
    # Without GPS the first system's column equals the clock's: one of the two must go.
    skipped = 1 if 0.0 < of_others == count else 0
    unknowns = np.empty(max(normal.b.shape[0] - skipped, 3), np.int64)
    for j in range(unknowns.shape[0]):
        unknowns[j] = j if j < 4 else j + skipped
    systems, dof = unknowns.shape[0] - 3, max(count - unknowns.shape[0], 0)
    if dof == 0:
        return 0.0, 0, systems
    cofactor, q = invert_positive_definite(covariance_block(normal.information, unknowns)), 0.0
    for i in range(unknowns.shape[0]):
        for j in range(unknowns.shape[0]):
            q += normal.b[unknowns[i]] * cofactor[i, j] * normal.b[unknowns[j]]
    return normal.total - q, dof, systems
