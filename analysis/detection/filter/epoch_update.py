"""What an epoch does to the filter and to its memory, in one call, once it is known what to trust.

The ranges are used first, then the Doppler rates against what the ranges have told.
"""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.information import block, columns, narrowed, states_of, take, weighed
from analysis.detection.filter.measurement import Indices, Modelled
from analysis.detection.isolation.assessment import RATE_STATES, weighed_rates
from analysis.detection.isolation.ramp_test import Memory, Strongest
from analysis.detection.isolation.ramp_windows import (
    learn_offsets,
    respond,
    respond_to_rates,
    strongest,
)
from analysis.detection.values import Value
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled


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
) -> None:
    """Update x and p in place."""
    states = states_of(h)
    information, b, _ = weighed(columns(h, states), variance, v)
    told = narrowed(block(p, states), information)[1]
    _, moved = take(x, p, states, told, b)
    information, b, _, _ = weighed_rates(rates_h, rate_variance, v_rate)
    absorb_rates(x, p, information, b, moved)


@compiled
def absorb_rates(x: Vector, p: Vector, information: Vector, b: Vector, moved: Vector) -> Vector:
    """Update x, p and b in place by rates of N and b (4,) after the ranges moved the state by
    `moved` (20,); returns P+_:c (20, 4)."""
    for i in range(b.shape[0]):  # what the ranges' update has told is no news
        for j in range(b.shape[0]):
            b[i] -= information[i, j] * moved[RATE_STATES[j]]
    told = narrowed(block(p, RATE_STATES), information)[1]
    return take(x, p, RATE_STATES, told, b)[0]


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
    states = states_of(h)
    a = columns(h, states)
    information, b, _ = weighed(a, variance, v)
    told = narrowed(block(p, states), information)[1]
    of_rates, b_rates, _, _ = weighed_rates(rates_h, rate_variance, v_rate)
    return followed(
        x,
        p,
        states,
        a,
        information,
        variance,
        v,
        told,
        b,
        of_rates,
        b_rates,
        phi,
        dt_s,
        t_us,
        starts_us,
        d,
        sums,
        offset,
        spread,
        offsets,
        spreads,
        inertial,
        numbers,
    )


@compiled
def followed(
    x: Vector,
    p: Vector,
    states: Indices,
    a: Vector,
    information: Vector,
    variance: Vector,
    v: Vector,
    told: Vector,
    b: Vector,
    of_rates: Vector,
    b_rates: Vector,
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
    """Filter and memory, as new arrays, after ranges of N, b and Y (`told`) and rates of N and b;
    what the windows say of them (`memory.strongest`)."""
    prior = block(p, states)
    x, p = x.copy(), p.copy()
    after, moved = take(x, p, states, told, b)
    after_rates = absorb_rates(x, p, of_rates, b_rates, moved)
    ages = np.zeros(starts_us.shape[0])
    for w in range(ages.shape[0]):
        if starts_us[w] != 0:
            ages[w] = (t_us - starts_us[w]) * 1e-6
    d, sums = respond(d, sums, offsets, ages, phi, after, states, a, information, variance, v, dt_s)
    respond_to_rates(d, sums, after_rates, RATE_STATES, of_rates, b_rates)
    offset, spread = learn_offsets(offset, spread, prior, a, variance, v, dt_s, numbers)
    found = strongest(sums, spreads, ages, inertial, numbers)
    return x, p, d, sums, offset, spread, found
