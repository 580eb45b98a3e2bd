"""Measurement updates by the information on the few states that measurements observe.

Ranges observe position, clock and the systems' offsets, Doppler rates velocity and drift: c states
each, 4 to 7 of 20. The equations, the Kalman update by the matrix inversion lemma [1]_ without any
inverse of size n, are in docs/fdi.md, "Filter"; N, b, E, T, F, Y and P+ are theirs.

References
----------
.. [1] D. Simon, Optimal State Estimation, 2006, sections 1.1.2 and 6.1.
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, PSI, X_BG, X_Q, V
from analysis.samples.block import Indices
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite, multiply_matrices
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_in_reference

RATE_STATES = np.array([V, V + 1, V + 2, DRIFT])
VAGUE_INFORMATION = 1e-9  # 1/m^2: keeps N regular where no measurement observes an unknown
# Measurements for each state: a snapshot of fewer follows lasting errors further than the filter.
LEAST_REDUNDANCY = 2


class NormalEquations(NamedTuple):
    """n measurements as normal equations over the c states that they observe.

    `states` (c,) are those states, `a` (n, c) the geometry over them, `variance` and `v` (n,) noise
    and innovations; `information` (c, c) is N, `b` (c,) is b, and `total` v' inv(R) v. `white`
    (c, c) is inv(E) where a part of the noise lasts, and empty where all of it counts as white.
    """

    states: Indices
    a: Vector
    variance: Vector
    v: Vector
    information: Vector
    b: Vector
    total: float
    white: Vector


@compiled
def normal_equations(h: Vector, variance: Vector, v: Vector, white: Vector) -> NormalEquations:
    """Normal equations of innovations v (n,) with variance (n,), of which `white` (n,) is white,
    and geometry h (n, 20), over the states that they observe."""
    states, a, count = np.empty(h.shape[1], np.int64), np.empty((h.shape[0], h.shape[1])), 0
    for j in range(h.shape[1]):
        observed = False
        for i in range(h.shape[0]):
            a[i, count] = h[i, j]
            observed |= h[i, j] != 0.0
        if observed:
            states[count] = j
            count += 1
    return normal_equations_over(states[:count], a[:, :count].copy(), variance, v, white)


@compiled
def normal_equations_over(
    states: Indices, a: Vector, variance: Vector, v: Vector, white: Vector
) -> NormalEquations:
    """Normal equations of innovations with geometry a (n, c) over the states `states` (c,)."""
    count, lasts = a.shape[1], False
    information, b, total = np.zeros((count, count)), np.zeros(count), 0.0
    e = VAGUE_INFORMATION * np.eye(count)
    for i in range(a.shape[0]):
        total += v[i] * v[i] / variance[i]
        lasts |= white[i] != variance[i]
        for j in range(count):
            share = a[i, j] / variance[i]
            b[j] += share * v[i]
            for k in range(count):
                information[j, k] += share * a[i, k]
                e[j, k] += share * a[i, k] * white[i] / variance[i]
    lasts = lasts and a.shape[0] >= LEAST_REDUNDANCY * count
    inverse = invert_positive_definite(e) if lasts else np.empty((0, 0))
    return NormalEquations(states, a, variance, v, information, b, total, inverse)


@compiled
def rate_equations(h: Vector, variance: Vector, v: Vector) -> NormalEquations:
    """Normal equations of velocity and clock drift from the Doppler residuals v (n,), NaN where
    there is none; h (n, 20) are the rows of the ranges."""
    count = 0
    a, known_variance, known = np.ones((v.shape[0], 4)), np.empty(v.shape[0]), np.empty(v.shape[0])
    for i in range(v.shape[0]):
        if math.isfinite(v[i]):
            for k in range(3):
                a[count, k] = h[i, k]
            known_variance[count], known[count] = variance[i], v[i]
            count += 1
    # A copy: a global array is a constant of the compiled code and may not be changed.
    variance = known_variance[:count]
    return normal_equations_over(RATE_STATES.copy(), a[:count], variance, known[:count], variance)


_NONE, _TABLE = np.empty(0), np.empty((0, 0))
NO_RATES = NormalEquations(
    RATE_STATES.copy(), _TABLE, _NONE, _NONE, np.zeros((4, 4)), np.zeros(4), 0.0, _TABLE
)


@compiled
def covariance_block(p: Vector, states: Indices) -> Vector:
    """The covariance (c, c) of some states."""
    out = np.empty((states.shape[0], states.shape[0]))
    for i in range(states.shape[0]):
        for j in range(states.shape[0]):
            out[i, j] = p[states[i], states[j]]
    return out


@compiled
def posterior_block(prior: Vector, normal: NormalEquations) -> tuple[Vector, Vector, Vector]:
    """F, T and Y (c, c) of P_c and measurements."""
    before, n, t = invert_positive_definite(prior), normal.information, np.eye(len(normal.b))
    if len(normal.white):
        t = multiply_matrices(n, normal.white)
        n = multiply_matrices(t, n)
    after = invert_positive_definite(before + n)
    y = before - multiply_matrices(before, multiply_matrices(after, before))
    if not len(normal.white):
        return after, t, y
    fit = multiply_matrices(t.T, multiply_matrices(after, t)) - normal.white
    return fit + _cofactor(normal), t, y


@compiled
def _cofactor(normal: NormalEquations) -> Vector:
    """C (c, c), the covariance of a snapshot of measurements."""
    vague = VAGUE_INFORMATION * np.eye(len(normal.b))
    return invert_positive_definite(normal.information + vague)


@compiled
def posterior_statistic(normal: NormalEquations, fit: Vector) -> float:
    """The chi-square statistic of measurements, given their F (c, c) of `posterior_block`."""
    q = normal.total
    for i in range(fit.shape[0]):
        for j in range(fit.shape[0]):
            q -= normal.b[i] * fit[i, j] * normal.b[j]
    return q


@compiled
def lasting_covariance(normal: NormalEquations) -> Vector:
    """The covariance C - C E C (c, c) of a snapshot's lasting errors."""
    c, e = _cofactor(normal), invert_positive_definite(normal.white)
    return c - multiply_matrices(c, multiply_matrices(e, c))


def innovation_statistic(p: Vector, normal: NormalEquations) -> float:
    """q of measurements before the covariance p (20, 20)."""
    fit, *_ = posterior_block(covariance_block(p, normal.states), normal)
    return posterior_statistic(normal, fit)


def inverse_covariance(p: Vector, normal: NormalEquations) -> Vector:
    """The inverse innovation covariance M (n, n) of measurements before the covariance p."""
    fit, *_ = posterior_block(covariance_block(p, normal.states), normal)
    weighted = normal.a / normal.variance[:, None]
    return np.diag(1.0 / normal.variance) - weighted @ fit @ weighted.T


def add_error(x: Vector, d: Vector) -> Vector:
    """The state x (21,) with an error d (20,), which rotates the quaternion and adds elsewhere."""
    turned = rotate_in_reference(x[X_Q:X_BG], *d[PSI : PSI + 3].tolist())
    return np.concatenate((x[:X_Q] + d[:PSI], turned, x[X_BG:] + d[PSI + 3 :]))


@compiled
def reduce_covariance(
    p: Vector, normal: NormalEquations
) -> tuple[Vector, tuple[Vector, Vector], Vector]:
    """Covariance P+ (20, 20) after measurements, its columns P+_:c T (20, c) with F (c, c), and dx
    (20,)."""
    states = normal.states
    fit, t, y = posterior_block(covariance_block(p, states), normal)
    out, after = p.copy(), np.zeros((p.shape[0], states.shape[0]))
    moved, weighted = np.zeros(p.shape[0]), np.empty(states.shape[0])
    for i in range(p.shape[0]):
        for k in range(states.shape[0]):
            weighted[k] = 0.0
            for m in range(states.shape[0]):
                weighted[k] += y[k, m] * p[states[m], i]
        # Half alone, then mirrored: exactly symmetric.
        for j in range(i + 1):
            for k in range(states.shape[0]):
                out[i, j] -= p[states[k], j] * weighted[k]
            out[j, i] = out[i, j]
    for i in range(p.shape[0]):
        for k in range(states.shape[0]):
            for m in range(states.shape[0]):
                after[i, k] += out[i, states[m]] * t[m, k]
            moved[i] += after[i, k] * normal.b[k]
    return out, (after, fit), moved


class EpochUpdate(NamedTuple):
    """The filter after an epoch, the ranges and rates that it used, and P+_:c T (20, c) and F
    (c, c) of each."""

    motion: MotionEstimate
    ranges: NormalEquations
    after_ranges: tuple[Vector, Vector]
    rates: NormalEquations
    after_rates: tuple[Vector, Vector]


def update_filter(
    motion: MotionEstimate, ranges: NormalEquations, rates: NormalEquations
) -> EpochUpdate:
    """The filter after some ranges and rates, both with innovations against `motion`."""
    p, after_ranges, moved = reduce_covariance(motion.p, ranges)
    # The ranges have moved the state that the rates were predicted for.
    rates = rates._replace(b=rates.b - rates.information @ moved[RATE_STATES])
    p, after_rates, moved_again = reduce_covariance(p, rates)
    motion = motion._replace(x=add_error(add_error(motion.x, moved), moved_again), p=p)
    return EpochUpdate(motion, ranges, after_ranges, rates, after_rates)
