"""What one epoch asks of the filter, each in one call: every test at once, and every update.

An epoch without a fault needs nothing else; the verdicts of one with a fault come between the two.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.fdi.bank import normalised, projected_weights
from analysis.fdi.inertial import correct, innovate
from analysis.fdi.linear import apply
from analysis.fdi.measure import Modelled
from analysis.fdi.state import Motion
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

Indices = NDArray[np.int64]


class Innovated(NamedTuple):
    """P H' (18, n), the inverse innovation covariance M (n, n), u = M v (n,) and q = v' M v."""

    ph: Vector
    m: Vector
    u: Vector
    q: float


class Assessed(NamedTuple):
    """All tests of an epoch: the ranges' with `normalised` (n,), the rates' statistic over `rates`
    of them, and the parity statistic with its degrees of freedom (0 where it cannot be had)."""

    ranges: Innovated
    normalised: Vector
    q_rate: float
    rates: int
    parity: float
    parity_dof: int


class Update(NamedTuple):
    """What an update of the filter used: gain (18, m), inverse covariance (m, m), geometry
    (m, 18), variance and innovations (m,), of the ranges and of the rates."""

    gain: Vector
    m: Vector
    h: Vector
    variance: Vector
    v: Vector
    gain_rate: Vector
    m_rate: Vector
    h_rate: Vector
    v_rate: Vector


def innovated(p: Vector, modelled: Modelled) -> Innovated:
    """The ranges' innovations with the covariance p (18, 18) of the prediction."""
    return Innovated(*innovate(p, modelled.h, modelled.variance, modelled.v_m))


def assess(p: Vector, modelled: Modelled, galileo: Vector) -> Assessed:
    """Every test of an epoch's ranges and rates against the prediction with covariance p."""
    ph, m, u, each, numbers, counts = _assess(
        p,
        modelled.h,
        modelled.variance,
        modelled.v_m,
        modelled.h_rate,
        modelled.rate_variance,
        modelled.v_mps,
        galileo,
    )
    ranges = Innovated(ph, m, u, numbers[0])
    return Assessed(ranges, each, numbers[1], counts[0], numbers[2], counts[1])


@compiled
def _assess(
    p: Vector,
    h: Vector,
    variance: Vector,
    v: Vector,
    h_rate: Vector,
    rate_variance: Vector,
    v_rate: Vector,
    galileo: Vector,
) -> tuple[Vector, Vector, Vector, Vector, tuple[float, float, float], tuple[int, int]]:
    ph, m, u, q = innovate(p, h, variance, v)
    known, others = 0, 0
    for i in range(v.shape[0]):
        known += np.isfinite(v_rate[i])
        others += galileo[i]
    q_rate = 0.0
    if known > 0:
        rows, some, wide = np.empty((known, h.shape[1])), np.empty(known), np.empty(known)
        at = 0
        for i in range(v.shape[0]):
            if np.isfinite(v_rate[i]):
                some[at], wide[at] = v_rate[i], rate_variance[i]
                for j in range(h.shape[1]):
                    rows[at, j] = h_rate[i, j]
                at += 1
        q_rate = innovate(p, rows, wide, some)[3]
    columns = 5 if 0 < others < v.shape[0] else 4
    parity, dof = 0.0, max(v.shape[0] - columns, 0)
    if dof > 0:
        design, weight = np.empty((v.shape[0], columns)), np.empty(v.shape[0])
        for i in range(v.shape[0]):
            weight[i] = 1.0 / variance[i]
            for j in range(3):
                design[i, j] = h[i, j]
            design[i, 3] = 1.0
            if columns == 5:
                design[i, 4] = h[i, 17]
        left = apply(projected_weights(design, weight), v)
        for i in range(v.shape[0]):
            parity += v[i] * left[i]
    return ph, m, u, normalised(m, u), (q, q_rate, parity), (known, dof)


def absorb(
    motion: Motion, ranges: Modelled, taken: Innovated, rates: Modelled
) -> tuple[Motion, Update]:
    """The filter after the ranges of `ranges`, innovated as `taken`, and the rates of `rates`."""
    x, p, gain, gain_rate, m_rate, v_rate = _absorb(
        motion.x,
        motion.p,
        ranges.h,
        ranges.variance,
        taken.ph,
        taken.m,
        taken.u,
        rates.h_rate,
        rates.rate_variance,
        rates.v_mps,
    )
    update = Update(
        gain,
        taken.m,
        ranges.h,
        ranges.variance,
        ranges.v_m,
        gain_rate,
        m_rate,
        rates.h_rate,
        v_rate,
    )
    return motion._replace(x=x, p=p), update


@compiled
def _absorb(
    x: Vector,
    p: Vector,
    h: Vector,
    variance: Vector,
    ph: Vector,
    m: Vector,
    u: Vector,
    h_rate: Vector,
    rate_variance: Vector,
    v_rate: Vector,
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
    moved = apply(ph, u)
    x, p, gain = correct(x, p, h, variance, ph, m, u)
    left = v_rate.copy()  # what the ranges' update has told is no news for the rates
    for i in range(left.shape[0]):
        for j in range(moved.shape[0]):
            left[i] -= h_rate[i, j] * moved[j]
    ph_rate, m_rate, u_rate, _ = innovate(p, h_rate, rate_variance, left)
    x, p, gain_rate = correct(x, p, h_rate, rate_variance, ph_rate, m_rate, u_rate)
    return x, p, gain, gain_rate, m_rate, left
