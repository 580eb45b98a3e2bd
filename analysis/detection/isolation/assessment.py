"""An epoch as the filter sees it before it takes anything of it: one call, every test at once.

An epoch without a fault needs nothing else before its update; the verdicts of one with a fault
start from what is told here.
"""

import math

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.information import (
    block,
    columns,
    narrowed,
    quadratic,
    quadratic_of,
    states_of,
    weighed,
)
from analysis.detection.filter.measurement import (
    NO_ROWS,
    Indices,
    Mask,
    Modelled,
    Observed,
    modelled_at,
)
from analysis.detection.values import Value
from analysis.orbits.broadcast import satellite_states
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import apply, inverse

CLOCK_LEAP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites
RATE_STATES = np.array([3, 4, 5, 16])  # velocity and drift


class Assessed(Value, frozen=True):
    """All tests of an epoch: the ranges' q with `normalised` (n,), the rates' statistic over
    `rates` of them, and the parity statistic with its degrees of freedom (0 where there is none).
    """

    q: float
    normalised: Vector
    q_rate: float
    rates: int
    parity: float
    parity_dof: int


class Sight(Value, frozen=True):
    """What an epoch measured above the mask, against the prediction.

    `used` are the innovations of `names`, which are trusted, with their tests; `left` those of
    `others`, which are left out. `far` says that most innovations are over `CLOCK_LEAP_M`.
    """

    names: tuple[str, ...]
    used: Modelled
    assessed: Assessed
    others: tuple[str, ...]
    left: Modelled
    systems: int
    far: bool


def see(
    observed: Observed,
    trusted: Mask,
    held_m: Vector,
    motion: Motion,
    ionosphere: Vector,
    config: DetectorConfig,
) -> Sight:
    """An epoch modelled and tested; `trusted` (n,) may be used, `held_m` (n,) is taken off."""
    order, table, h, numbers, counts = _see(
        *observed.measured,
        trusted,
        held_m,
        motion.x,
        motion.p,
        ionosphere,
        config.sigma.numbers,
        config.mask_rad,
    )
    count, seen, systems, rates, dof, far = counts
    names = observed.satellites
    others: tuple[str, ...] = ()
    if count < len(names):
        sorted_names = [names[i] for i in order.tolist()]
        names, others = tuple(sorted_names[:count]), tuple(sorted_names[count:seen])
    q, q_rate, parity = numbers
    left = NO_ROWS
    if others:
        left = _modelled(table[:, count:seen], h[count:seen])
    return Sight(
        names,
        _modelled(table[:, :count], h[:count]),
        Assessed(q, table[5, :count], q_rate, rates, parity, dof),
        others,
        left,
        systems,
        2 * far >= seen > 0,
    )


def _modelled(table: Vector, h: Vector) -> Modelled:
    return Modelled(table[0], table[1], table[2], table[3], table[4], h)


@compiled
def _see(
    packed: Vector,
    pseudorange_m: Vector,
    doppler_mps: Vector,
    cn0_dbhz: Vector,
    system: Indices,
    week: float,
    tow_s: float,
    trusted: Mask,
    held_m: Vector,
    x: Vector,
    p: Vector,
    ionosphere: Vector,
    sigma: Vector,
    mask_rad: float,
) -> tuple[
    Indices,
    Vector,
    Vector,
    tuple[float, float, float],
    tuple[int, int, int, int, int, int],
]:
    """The order of the satellites (used, left out, below the mask), their numbers (6, n) and
    geometry (n, 20) in it; statistics and counts."""
    states = satellite_states(packed, week, tow_s, pseudorange_m)
    found, geometry = modelled_at(
        states, pseudorange_m, doppler_mps, cn0_dbhz, system, x, tow_s, ionosphere, sigma
    )
    order, count, seen = _sorted(found[4], trusted, mask_rad)
    total = order.shape[0]
    table, h, kinds = np.empty((6, total)), np.empty_like(geometry), np.empty_like(system)
    far = 0
    for i in range(total):
        at = order[i]
        for k in range(5):
            table[k, i] = found[k, at]
        for k in range(h.shape[1]):
            h[i, k] = geometry[at, k]
        kinds[i] = system[at]
        table[0, i] -= held_m[at]
        far += i < seen and abs(table[0, i]) > CLOCK_LEAP_M
    used = h[:count]
    variance, v = table[2, :count], table[0, :count]
    estimated = states_of(used)
    a = columns(used, estimated)
    information, b, total = weighed(a, variance, v)
    after = narrowed(block(p, estimated), information)[0]
    normalise(a, after, b, variance, v, table[5])
    q = total - quadratic(b, after)
    parity, dof, systems = parity_test(a, information, b, total)
    of_rates, b_rates, total_rates, rates = weighed_rates(used, table[3, :count], table[1, :count])
    q_rate = rates_statistic(p, of_rates, b_rates, total_rates)
    return order, table, h, (q, q_rate, parity), (count, seen, systems, rates, dof, far)


@compiled
def normalise(
    a: Vector, after: Vector, b: Vector, variance: Vector, v: Vector, out: Vector
) -> None:
    """Fill `out` with u_i / sqrt(M_ii), standard normal without faults, whose squares are what q is
    less without i; NaN where a satellite is not checked by the others. `after` is P+_c."""
    moved = apply(after, b)
    for i in range(a.shape[0]):
        left, own = v[i], 1.0 - quadratic_of(a, i, after) / variance[i]
        for j in range(a.shape[1]):
            left -= a[i, j] * moved[j]
        known = own > 1e-12 * variance[i]
        out[i] = left / math.sqrt(own * variance[i]) if known else np.nan


@compiled
def parity_test(a: Vector, information: Vector, b: Vector, total: float) -> tuple[float, int, int]:
    """The statistic of the snapshot's residuals, its degrees of freedom, and how many systems.

    A snapshot solves for the states that are seen; where no satellite is GPS's, its first system's
    offset is the clock's.
    """
    of_gps = 0
    for i in range(a.shape[0]):
        own = 0.0
        for j in range(4, a.shape[1]):
            own += a[i, j]
        of_gps += own == 0.0
    skipped = 0 if of_gps else 1
    unknowns = np.empty(max(a.shape[1] - skipped, 3), dtype=np.int64)
    for j in range(unknowns.shape[0]):
        unknowns[j] = j if j < 4 else j + skipped
    systems, dof = unknowns.shape[0] - 3, max(a.shape[0] - unknowns.shape[0], 0)
    if dof == 0:
        return 0.0, 0, systems
    some = np.empty(unknowns.shape[0])
    for j in range(some.shape[0]):
        some[j] = b[unknowns[j]]
    return total - quadratic(some, inverse(block(information, unknowns))), dof, systems


@compiled
def _sorted(elevation: Vector, trusted: Mask, mask_rad: float) -> tuple[Indices, int, int]:
    """Indices (n,): trusted and above the mask, left out, below it; where each kind ends."""
    order = np.empty(elevation.shape[0], dtype=np.int64)
    count, ends = 0, np.zeros(3, dtype=np.int64)
    for kind in range(3):
        for i in range(elevation.shape[0]):
            below = not elevation[i] >= mask_rad
            if (2 if below else 0 if trusted[i] else 1) == kind:
                order[count] = i
                count += 1
        ends[kind] = count
    return order, ends[0], ends[1]


@compiled
def rates_statistic(p: Vector, information: Vector, b: Vector, total: float) -> float:
    """The statistic of Doppler rates of N, b and v' inv(R) v (`weighed_rates`)."""
    return total - quadratic(b, narrowed(block(p, RATE_STATES), information)[0])


@compiled
def weighed_rates(h: Vector, variance: Vector, v: Vector) -> tuple[Vector, Vector, float, int]:
    """N, b and v' inv(R) v of the Doppler rates v (n,) that are known, and how many they are; h
    (n, 20) is the geometry of the ranges."""
    count = 0
    a, wide, some = np.empty((v.shape[0], 4)), np.empty(v.shape[0]), np.empty(v.shape[0])
    for i in range(v.shape[0]):
        if np.isfinite(v[i]):
            for k in range(3):
                a[count, k] = h[i, k]
            a[count, 3], wide[count], some[count] = 1.0, variance[i], v[i]
            count += 1
    information, b, total = weighed(a[:count], wide[:count], some[:count])
    return information, b, total, count
