"""Every test statistic of an epoch in one compiled call, before the filter uses it."""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.information import (
    NormalEquations,
    covariance_block,
    normal_equations,
    normal_statistic,
    posterior_block,
    quadratic_form,
    rate_equations,
    row_quadratic_form,
)
from analysis.detection.filter.measurement import (
    EpochMeasurements,
    Indices,
    Innovations,
    Mask,
    innovations_kernel,
    transmitting_states,
)
from analysis.detection.filter.range_noise import SigmaNumbers
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite, multiply_vector

CLOCK_JUMP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites
LEAST_RATES = 5  # four states and one to spare


class EpochStatistics(NamedTuple):
    """The tests of an epoch's trusted satellites (n,), before any verdict.

    `normalised` (n,) are the ranges' innovations as standard normal numbers.
    `q` is the ranges' statistic, `q_rate` that of the `rates` known Doppler rates, `parity` that of
    the snapshot's residuals with `parity_dof` degrees of freedom (0: no test); `systems` counts the
    systems in use. `far` says that most innovations exceed `CLOCK_JUMP_M`.
    """

    normalised: Vector
    q: float
    q_rate: float
    rates: int
    parity: float
    parity_dof: int
    systems: int
    far: bool


class OrderedInnovations(NamedTuple):
    """n satellites against the prediction, in one order: trusted ones, excluded ones, those below
    the mask.

    `order` (n,) are their places in the observation, `innovations` are in this order: the first
    `trusted` are trusted, and those up to `above` lie above the mask.
    """

    order: Indices
    innovations: Innovations
    trusted: int
    above: int
    statistics: EpochStatistics


@compiled
def compute_statistics(
    measurements: EpochMeasurements,
    trusted: Mask,
    offset_m: Vector,
    x: Vector,
    p: Vector,
    ionosphere: Vector,
    sigma: SigmaNumbers,
    mask_rad: float,
) -> OrderedInnovations:
    """Every test of an epoch at the prediction x (21,) with covariance p (20, 20); `trusted` (n,)
    may be used, `offset_m` (n,) is subtracted from the ranges."""
    innovations = innovations_kernel(
        measurements, transmitting_states(measurements), x, ionosphere, sigma
    )
    # Excluded satellites have innovations too: they earn their readmission by these.
    order, count, above = _sorted(innovations.elevation_rad, trusted, mask_rad)
    far = 0
    if count < order.shape[0]:  # else all are trusted, in the order they have
        innovations = _in_order(innovations, order)
    h, v = innovations.geometry[:count], innovations.range_m
    # In place: `v` is new in this call.
    for i in range(order.shape[0]):
        v[i] -= offset_m[order[i]]
        far += i < above and abs(v[i]) > CLOCK_JUMP_M
    normal = normal_equations(h, innovations.variance[:count], v[:count])
    after = posterior_block(covariance_block(p, normal.states), normal.information)[0]
    q = normal.total - quadratic_form(normal.b, after)
    parity, dof, systems = parity_test(normal)
    rates = rate_equations(h, innovations.rate_variance[:count], innovations.rate_mps[:count])
    statistics = EpochStatistics(
        normalise_innovations(normal, after),
        q,
        normal_statistic(p, rates),
        rates.v.shape[0],
        parity,
        dof,
        systems,
        # Half of them at least: no fault has this on most satellites at once.
        2 * far >= above > 0,
    )
    return OrderedInnovations(order, innovations, count, above, statistics)


@compiled
def _in_order(innovations: Innovations, order: Indices) -> Innovations:
    """The innovations with their satellites in the order `order` (n,)."""
    return Innovations(
        innovations.range_m[order],
        innovations.rate_mps[order],
        innovations.variance[order],
        innovations.rate_variance[order],
        innovations.elevation_rad[order],
        innovations.ionosphere_m[order],
        innovations.geometry[order],
    )


@compiled
def normalise_innovations(normal: NormalEquations, after: Vector) -> Vector:
    """u_i / sqrt(M_ii) (n,), standard normal without faults, whose squares are what q loses
    without i; NaN where the others do not check a satellite. `after` is P+_c."""
    a, v, variances, out = normal.a, normal.v, normal.variance, np.empty(normal.v.shape[0])
    moved = multiply_vector(after, normal.b)
    for i in range(a.shape[0]):
        variance = variances[i]
        remaining, own = v[i], 1.0 - row_quadratic_form(a, i, after) / variance
        for j in range(a.shape[1]):
            remaining -= a[i, j] * moved[j]
        # A satellite that alone sees a state fits it exactly: its residual says nothing.
        known = own > 1e-12 * variance
        out[i] = remaining / math.sqrt(own * variance) if known else np.nan
    return out


@compiled
def parity_test(normal: NormalEquations) -> tuple[float, int, int]:
    """The statistic of the snapshot's residuals, its degrees of freedom, and how many systems.

    A snapshot solves for the states that the ranges observe; without GPS the offset of the first
    system takes the place of the clock.
    """
    a, of_gps = normal.a, 0
    for i in range(a.shape[0]):
        own = 0.0
        for j in range(4, a.shape[1]):
            own += a[i, j]
        of_gps += own == 0.0
    # Without GPS the first system's column equals the clock's: one of the two must go.
    skipped = 0 if of_gps else 1
    unknowns = np.empty(max(a.shape[1] - skipped, 3), dtype=np.int64)
    for j in range(unknowns.shape[0]):
        unknowns[j] = j if j < 4 else j + skipped
    systems, dof = unknowns.shape[0] - 3, max(a.shape[0] - unknowns.shape[0], 0)
    if dof == 0:
        return 0.0, 0, systems
    b = normal.b[unknowns]
    return (
        normal.total
        - quadratic_form(
            b, invert_positive_definite(covariance_block(normal.information, unknowns))
        ),
        dof,
        systems,
    )


@compiled
def _sorted(elevation: Vector, trusted: Mask, mask_rad: float) -> tuple[Indices, int, int]:
    """Indices (n,): trusted, excluded, below the mask; where the first two kinds end."""
    order = np.empty(elevation.shape[0], dtype=np.int64)
    count, ends = 0, np.zeros(3, dtype=np.int64)
    for kind in range(3):
        for i in range(elevation.shape[0]):
            # `not >=`, so that a NaN elevation counts as below.
            below = not elevation[i] >= mask_rad
            # Trusted ones first, so that the rest of the epoch works on one slice.
            if (2 if below else 0 if trusted[i] else 1) == kind:
                order[count] = i
                count += 1
        ends[kind] = count
    return order, ends[0], ends[1]
