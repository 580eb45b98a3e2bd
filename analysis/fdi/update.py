"""What an epoch does to the filter and to its memory, in one call, once it is known what to trust.

The ranges are used first, then the Doppler rates against what the ranges have told.
"""

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import correct, innovate
from analysis.fdi.linear import apply
from analysis.fdi.measure import Indices, Modelled, rate_rows
from analysis.fdi.memory import learn_offsets, respond, respond_to_rates, strongest
from analysis.fdi.sight import Innovated, finite
from analysis.fdi.slow import Memory, Strongest
from analysis.fdi.state import Motion
from analysis.fdi.value import Value
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled


class Rates(Value, frozen=True):
    """Doppler rates that fit, NaN where one does not: v and variance (n,), geometry of the ranges
    of the same satellites (n, 20)."""

    v: Vector
    variance: Vector
    h: Vector


def innovated(p: Vector, modelled: Modelled) -> Innovated:
    """The ranges' innovations with the covariance p (20, 20) of the prediction."""
    return Innovated(*innovate(p, modelled.h, modelled.variance, modelled.v_m))


def absorb(motion: Motion, ranges: Modelled, taken: Innovated, rates: Rates) -> Motion:
    """The filter after the ranges of `ranges`, innovated as `taken`, and the rates of `rates`."""
    x, p, *_ = _absorb(
        motion.x,
        motion.p,
        ranges.h,
        ranges.variance,
        taken.ph,
        taken.m,
        taken.u,
        rates.h,
        rates.variance,
        rates.v,
    )
    return motion._replace(x=x, p=p)


def remember(
    motion: Motion,
    ranges: Modelled,
    taken: Innovated,
    rates: Rates,
    memory: Memory,
    phi: Vector,
    dt_s: float,
    config: DetectorConfig,
) -> tuple[Motion, Memory, Strongest]:
    """The same, the memory of the epochs before with it, and what its windows say now.

    `memory` is over the satellites of `ranges`; phi (20, 20) the transition since the last epoch.
    """
    x, p, d, sums, offset, spread, found = _remember(
        motion.x,
        motion.p,
        ranges.h,
        ranges.variance,
        ranges.v_m,
        taken.ph,
        taken.m,
        taken.u,
        rates.h,
        rates.variance,
        rates.v,
        phi,
        dt_s,
        motion.t_us,
        memory.starts_us,
        memory.d,
        memory.sums,
        memory.offset,
        memory.spread,
        memory.offsets,
        memory.spreads,
        motion.inertial,
        config.memory_numbers,
    )
    memory = memory._replace(d=d, sums=sums, offset=offset, spread=spread)
    return motion._replace(x=x, p=p), memory, Strongest(*found)


@compiled
def _absorb(
    x: Vector,
    p: Vector,
    h: Vector,
    variance: Vector,
    ph: Vector,
    m: Vector,
    u: Vector,
    rates_h: Vector,
    rate_variance: Vector,
    v_rate: Vector,
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector, Vector]:
    """State, covariance and gain; gain, M, geometry and innovations of the rates."""
    moved = apply(ph, u)
    x, p, gain = correct(x, p, h, variance, ph, m, u)
    known = finite(v_rate)
    rows = rate_rows(rates_h, known)
    left, wide = np.empty(known.shape[0]), np.empty(known.shape[0])
    for i in range(left.shape[0]):
        left[i], wide[i] = v_rate[known[i]], rate_variance[known[i]]
        for j in range(moved.shape[0]):  # what the ranges' update has told is no news
            left[i] -= rows[i, j] * moved[j]
    ph_rate, m_rate, u_rate, _ = innovate(p, rows, wide, left)
    x, p, gain_rate = correct(x, p, rows, wide, ph_rate, m_rate, u_rate)
    return x, p, gain, gain_rate, m_rate, rows, left


@compiled
def _remember(
    x: Vector,
    p: Vector,
    h: Vector,
    variance: Vector,
    v: Vector,
    ph: Vector,
    m: Vector,
    u: Vector,
    rates_h: Vector,
    rate_variance: Vector,
    v_rate: Vector,
    phi: Vector,
    dt_s: float,
    t_us: int,
    starts_us: Indices,
    d: Vector,
    sums: Vector,
    offset: Vector,
    spread: Vector,
    offsets: Vector,
    spreads: Vector,
    inertial: bool,
    numbers: Vector,
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector, tuple[float, int, int, float]]:
    after, wide, gain, gain_rate, m_rate, rows, left = _absorb(
        x, p, h, variance, ph, m, u, rates_h, rate_variance, v_rate
    )
    ages = np.zeros(starts_us.shape[0])
    for w in range(ages.shape[0]):
        if starts_us[w] != 0:
            ages[w] = (t_us - starts_us[w]) * 1e-6
    d, sums = respond(d, sums, offsets, ages, phi, gain, m, h, v, dt_s)
    if left.shape[0] > 0:
        d, sums = respond_to_rates(d, sums, gain_rate, m_rate, rows, left)
    offset, spread = learn_offsets(offset, spread, p, h, variance, v, dt_s, numbers)
    found = strongest(sums, spreads, ages, inertial, numbers)
    return after, wide, d, sums, offset, spread, found
