"""An epoch as the filter sees it before it uses anything of it: one call, every test at once.

A quiet epoch, one in which no test trips, needs nothing else before its update; the verdicts of any
other start from these tests.
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig, SigmaNumbers
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, V
from analysis.detection.filter.information import (
    NormalEquations,
    covariance_block,
    normal_equations,
    normal_equations_over,
    normal_statistic,
    posterior_block,
    quadratic_form,
    row_quadratic_form,
)
from analysis.detection.filter.measurement import (
    NO_INNOVATIONS,
    EpochMeasurements,
    EpochObservation,
    Indices,
    Innovations,
    Mask,
    innovations_kernel,
    transmitting_states,
)
from analysis.detection.values import Value
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite, multiply_vector

CLOCK_JUMP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites
RATE_STATES = np.array([V, V + 1, V + 2, DRIFT])
LEAST_RATES = 5  # four states and one to spare


class EpochStatistics(NamedTuple):
    """What the tests of an epoch say of the satellites (used,) that are trusted.

    `residual_m` and `normalised` (used,) are their innovations. `q` is the ranges' statistic,
    `q_rate` that of the `rates` Doppler rates that are known, `parity` that of the snapshot's
    residuals with its degrees of freedom (0 where there is none); `systems` is how many systems are
    used. `far` says that most innovations are over `CLOCK_JUMP_M`.
    """

    residual_m: Vector
    normalised: Vector
    q: float
    q_rate: float
    rates: int
    parity: float
    parity_dof: int
    systems: int
    far: bool


class Assessment(NamedTuple):
    """n satellites against the prediction, in one order: trusted ones, excluded ones, those below
    the mask.

    `order` (n,) are their places among the observed, `every` the innovations in this order, of
    which the first `used` are trusted and those up to `above` are above the mask. `ranges` and
    `rates` are the normal equations of the trusted ones, and `y` (c, c) is Y of the ranges, so that
    a quiet epoch can be committed without doing the tests' work again.
    """

    order: Indices
    every: Innovations
    used: int
    above: int
    statistics: EpochStatistics
    ranges: NormalEquations
    y: Vector
    rates: NormalEquations


class Sight(Value, frozen=True):
    """What an epoch measured above the mask: the satellites `names` are trusted, with the
    innovations `used`, `excluded` are not, with `outside`."""

    names: tuple[str, ...]
    used: Innovations
    excluded: tuple[str, ...]
    outside: Innovations
    tests: EpochStatistics


def see(
    observed: EpochObservation,
    trusted: Mask,
    offset_m: Vector,
    motion: MotionEstimate,
    ionosphere: Vector,
    config: DetectorConfig,
) -> Sight:
    """An epoch modelled and tested; `trusted` (n,) may be used, `offset_m` (n,) is subtracted."""
    assessed = assess(
        observed.measured,
        trusted,
        offset_m,
        motion.x,
        motion.p,
        ionosphere,
        config.sigma.numbers,
        config.mask_rad,
    )
    names, every, tests = observed.satellites, assessed.every, assessed.statistics
    count, above = assessed.used, assessed.above
    if count == len(names):
        return Sight(names, every, (), NO_INNOVATIONS, tests)
    in_order = tuple(names[i] for i in assessed.order.tolist())
    used, outside = every.between(0, count), every.between(count, above)
    return Sight(in_order[:count], used, in_order[count:above], outside, tests)


@compiled
def assess(
    measured: EpochMeasurements,
    trusted: Mask,
    offset_m: Vector,
    x: Vector,
    p: Vector,
    ionosphere: Vector,
    sigma: SigmaNumbers,
    mask_rad: float,
) -> Assessment:
    """Every test of an epoch at the prediction x (21,) with covariance p (20, 20)."""
    observed = innovations_kernel(measured, transmitting_states(measured), x, ionosphere, sigma)
    # Excluded satellites are modelled too: they earn their readmission by these innovations.
    order, count, above = _sorted(observed.elevation_rad, trusted, mask_rad)
    every, far = observed, 0
    if count < order.shape[0]:  # else all are trusted, in the order they have
        every = _in_order(observed, order)
    h, v = every.h[:count], every.v_m
    # In place: `v` is the array of `every`, new in this call.
    for i in range(order.shape[0]):
        v[i] -= offset_m[order[i]]
        far += i < above and abs(v[i]) > CLOCK_JUMP_M
    normal = normal_equations(h, every.variance[:count], v[:count])
    after, y = posterior_block(covariance_block(p, normal.states), normal.information)
    normalised = normalise_innovations(normal, after)
    q = normal.total - quadratic_form(normal.b, after)
    parity, dof, systems = parity_test(normal)
    rates = rate_equations(h, every.rate_variance[:count], every.v_mps[:count])
    q_rate = normal_statistic(p, rates)
    statistics = EpochStatistics(
        v[:count],
        normalised,
        q,
        q_rate,
        rates.v.shape[0],
        parity,
        dof,
        systems,
        # Half of them at least: no fault has this on most satellites at once.
        2 * far >= above > 0,
    )
    return Assessment(order, every, count, above, statistics, normal, y, rates)


@compiled
def _in_order(every: Innovations, order: Indices) -> Innovations:
    """The same satellites (n,) in an order."""
    h_before = every.h
    h = np.empty_like(h_before)
    for i in range(order.shape[0]):
        for k in range(h.shape[1]):
            h[i, k] = h_before[order[i], k]
    return Innovations(
        _at(every.v_m, order),
        _at(every.v_mps, order),
        _at(every.variance, order),
        _at(every.rate_variance, order),
        _at(every.elevation_rad, order),
        _at(every.ionosphere_m, order),
        h,
    )


@compiled
def _at(values: Vector, order: Indices) -> Vector:
    out = np.empty(order.shape[0])
    for i in range(order.shape[0]):
        out[i] = values[order[i]]
    return out


@compiled
def normalise_innovations(normal: NormalEquations, after: Vector) -> Vector:
    """u_i / sqrt(M_ii) (n,), standard normal without faults, whose squares are what q is less
    without i; NaN where a satellite is not checked by the others. `after` is P+_c."""
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

    A snapshot solves for the states that are seen; where no satellite is GPS's, its first system's
    offset is the clock's.
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
    b = _at(normal.b, unknowns)
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
    """Indices (n,): trusted and above the mask, left out, below it; where each kind ends."""
    order = np.empty(elevation.shape[0], dtype=np.int64)
    count, ends = 0, np.zeros(3, dtype=np.int64)
    for kind in range(3):
        for i in range(elevation.shape[0]):
            # `not >=`, so that a NaN elevation counts as below.
            below = not elevation[i] >= mask_rad
            # Trusted first, so that the rest of the epoch works on one slice.
            if (2 if below else 0 if trusted[i] else 1) == kind:
                order[count] = i
                count += 1
        ends[kind] = count
    return order, ends[0], ends[1]


@compiled
def rate_equations(h: Vector, variance: Vector, v: Vector) -> NormalEquations:
    """The normal equations of the Doppler rates v (n,) that are known; h (n, 20) is the geometry of
    the ranges."""
    count = 0
    a, known_variance, known = np.empty((v.shape[0], 4)), np.empty(v.shape[0]), np.empty(v.shape[0])
    for i in range(v.shape[0]):
        if np.isfinite(v[i]):
            for k in range(3):
                a[count, k] = h[i, k]
            a[count, 3], known_variance[count], known[count] = 1.0, variance[i], v[i]
            count += 1
    # A copy: a global array is a constant of the compiled code and may not be changed.
    return normal_equations_over(
        RATE_STATES.copy(), a[:count], known_variance[:count], known[:count]
    )
