"""An epoch as the filter sees it before it takes anything of it: one call, every test at once.

An epoch without a fault needs nothing else before its update; the verdicts of one with a fault
start from what is told here.
"""

import numpy as np

from analysis.fdi.bank import normalised, projected_weights
from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import innovate
from analysis.fdi.linear import apply
from analysis.fdi.measure import (
    NO_ROWS,
    Indices,
    Mask,
    Modelled,
    Observed,
    modelled_at,
    rate_rows,
)
from analysis.fdi.state import Motion
from analysis.fdi.value import Value
from analysis.gnss import SYSTEMS, satellite_states
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

CLOCK_LEAP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites
_CONSTELLATIONS = len(SYSTEMS)


class Innovated(Value, frozen=True):
    """P H' (20, n), the inverse innovation covariance M (n, n), u = M v (n,) and q = v' M v."""

    ph: Vector
    m: Vector
    u: Vector
    q: float


class Assessed(Value, frozen=True):
    """All tests of an epoch: the ranges' with `normalised` (n,), the rates' statistic over `rates`
    of them, and the parity statistic with its degrees of freedom (0 where it cannot be had)."""

    ranges: Innovated
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
    order, table, h, ph, m, numbers, counts = _see(
        observed.packed,
        observed.pseudorange_m,
        observed.doppler_mps,
        observed.cn0_dbhz,
        observed.system,
        observed.week,
        observed.tow_s,
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
        Assessed(
            Innovated(ph, m, table[5, :count], q), table[6, :count], q_rate, rates, parity, dof
        ),
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
    Vector,
    Vector,
    tuple[float, float, float],
    tuple[int, int, int, int, int, int],
]:
    """The order of the satellites (used, left out, below the mask), their numbers (7, n) and
    geometry (n, 20) in it; P H' and M of those used, statistics and counts."""
    states = satellite_states(packed, week, tow_s, pseudorange_m)
    found, geometry = modelled_at(
        states, pseudorange_m, doppler_mps, cn0_dbhz, system, x, tow_s, ionosphere, sigma
    )
    order, count, seen = _sorted(found[4], trusted, mask_rad)
    total = order.shape[0]
    table, h, kinds = np.empty((7, total)), np.empty_like(geometry), np.empty_like(system)
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
    ph, m, u, q = innovate(p, used, variance, v)
    each = normalised(m, u)
    for i in range(count):
        table[5, i], table[6, i] = u[i], each[i]
    q_rate, rates = _rates(p, used, table[3, :count], table[1, :count])
    parity, dof, systems = _parity(used, variance, v, kinds[:count])
    return order, table, h, ph, m, (q, q_rate, parity), (count, seen, systems, rates, dof, far)


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
def _rates(p: Vector, h: Vector, variance: Vector, v: Vector) -> tuple[float, int]:
    """The statistic of the Doppler rates that are known, and how many they are."""
    known = finite(v)
    count = known.shape[0]
    if count == 0:
        return 0.0, 0
    some, wide = np.empty(count), np.empty(count)
    for i in range(count):
        some[i], wide[i] = v[known[i]], variance[known[i]]
    return innovate(p, rate_rows(h, known), wide, some)[3], count


@compiled
def finite(v: Vector) -> Indices:
    """Indices of the finite numbers among v (n,)."""
    known = np.empty(v.shape[0], dtype=np.int64)
    count = 0
    for i in range(v.shape[0]):
        if np.isfinite(v[i]):
            known[count] = i
            count += 1
    return known[:count]


@compiled
def _parity(h: Vector, variance: Vector, v: Vector, system: Indices) -> tuple[float, int, int]:
    """The statistic of the snapshot's residuals, its degrees of freedom, and how many systems."""
    count, systems = v.shape[0], 0
    column = np.zeros(_CONSTELLATIONS, dtype=np.int64)
    for kind in range(_CONSTELLATIONS):
        present = False
        for i in range(count):
            present |= system[i] == kind
        if present:
            column[kind] = 3 + systems  # the first has the clock's own
            systems += 1
    columns = 3 + systems
    dof = max(count - columns, 0)
    if dof == 0:
        return 0.0, 0, systems
    design, weight = np.zeros((count, columns)), np.empty(count)
    for i in range(count):
        weight[i] = 1.0 / variance[i]
        for j in range(3):
            design[i, j] = h[i, j]
        design[i, 3] = 1.0
        design[i, column[system[i]]] = 1.0
    left = apply(projected_weights(design, weight), v)
    parity = 0.0
    for i in range(count):
        parity += v[i] * left[i]
    return parity, dof, systems
