"""What an epoch does to the filter and to its memory, in one call, once it is known what to trust.

The ranges are used first, then the Doppler rates against what the ranges have told.
"""

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.information import block, columns, states_of, take, weighed
from analysis.fdi.measure import Indices, Modelled
from analysis.fdi.memory import learn_offsets, respond, respond_to_rates, strongest
from analysis.fdi.sight import RATE_STATES, weighed_rates
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


def absorb(motion: Motion, ranges: Modelled, rates: Rates) -> Motion:
    """The filter after some ranges and rates."""
    x, p = motion.x.copy(), motion.p.copy()
    _absorb(x, p, ranges.h, ranges.variance, ranges.v_m, rates.h, rates.variance, rates.v)
    return motion._replace(x=x, p=p)


def remember(
    motion: Motion,
    ranges: Modelled,
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
    v: Vector,
    rates_h: Vector,
    rate_variance: Vector,
    v_rate: Vector,
) -> tuple[Indices, Vector, Vector, Vector, Vector, Vector]:
    """Update x and p in place; returns the states that the ranges see (c,), their geometry over
    these (n, c) and P+_:c (20, c) after them; P+_:c (20, 4), N and b of the rates."""
    states = states_of(h)
    a = columns(h, states)
    information, b, _ = weighed(a, variance, v)
    after, moved = take(x, p, states, information, b)
    information, b, _, _ = weighed_rates(rates_h, rate_variance, v_rate)
    for i in range(b.shape[0]):  # what the ranges' update has told is no news
        for j in range(b.shape[0]):
            b[i] -= information[i, j] * moved[RATE_STATES[j]]
    after_rates, _ = take(x, p, RATE_STATES, information, b)
    return states, a, after, after_rates, information, b


@compiled
def _remember(
    x: Vector,
    p: Vector,
    h: Vector,
    variance: Vector,
    v: Vector,
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
    prior = p
    x, p = x.copy(), p.copy()
    states, a, after, after_rates, information, b = _absorb(
        x, p, h, variance, v, rates_h, rate_variance, v_rate
    )
    ages = np.zeros(starts_us.shape[0])
    for w in range(ages.shape[0]):
        if starts_us[w] != 0:
            ages[w] = (t_us - starts_us[w]) * 1e-6
    d, sums = respond(d, sums, offsets, ages, phi, after, states, a, variance, v, dt_s)
    respond_to_rates(d, sums, after_rates, RATE_STATES, information, b)
    offset, spread = learn_offsets(
        offset, spread, block(prior, states), a, variance, v, dt_s, numbers
    )
    found = strongest(sums, spreads, ages, inertial, numbers)
    return x, p, d, sums, offset, spread, found
