"""Protection levels: how far the position may be off at a stated integrity risk.

By solution separation, as in advanced RAIM [1]_, about the detector's own position: whichever
satellite, or whole system, may be faulty without having been found, the snapshot that does not use
it bounds the truth. With d_k the distance from the position to that snapshot and sigma_k what the
snapshot may be wrong by without a fault,

    level = max over k of |d_k| + K_k sigma_k,   Q(K_k) = risk / (3 axes, hypotheses, prior of k)

No sigma of the filter is in it. A hypothesis without enough satellites left makes the level
unknown; the fault of the only system in use cannot be seen and is not covered. With C = inv(A'WA)
and g = C a, a satellite's snapshot is a change of rank one [2]_:

    C_k = C + w g g' / (1 - w a'g),   x_k = x - w g (v - a'x) / (1 - w a'g).

References
----------
.. [1] Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51(1), 2015.
.. [2] Golub and Van Loan, Matrix Computations, 4th ed., 2013, 2.1.4.
.. [3] RTCA DO-229D, J.2.3: by geomagnetic latitude.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.lasting_errors import (
    AXES,
    IONOSPHERE_SHARE,
    TROPOSPHERE_M,
    Misfit,
    lasting_position_variance,
    snapshot_rows,
)
from analysis.detection.filter.measurement import Modelled
from analysis.detection.isolation.chi_square import two_sided
from analysis.orbits.broadcast import geomagnetic_latitude, troposphere_m
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.earth_kernel import geodetic, ned_axes
from mavproxy_fault.numerics.linear import inverse

RISK = 1e-7  # per epoch, of an error beyond a level without a word
SATELLITE_PRIOR, SYSTEM_PRIOR = 1e-5, 1e-4  # of a fault that nobody has announced [1]_
SIGNAL_M = 1.0  # sigma of orbit and clock for integrity [1]_
# Of the vertical ionosphere up to 20 degrees, up to 55 and beyond [3]_.
VERTICAL_M = 9.0, 4.5, 6.0
UNSEEN = 1e-9  # keeps the clock of a system without satellites from making N singular
WORST_M = 1e4  # a level beyond it is none


class Bounds(NamedTuple):
    """Of a position: the variance f of its noise, `lasting_m2` (3,) in ECEF of what lasts, and the
    protection levels, infinite where a fault that may be there could not be seen by the others."""

    factor: float
    lasting_m2: tuple[float, float, float]
    hpl_m: float
    vpl_m: float


def bounds(
    used: Modelled,
    moved_m: Vector,
    offset_m: Vector,
    r_ecef_m: Vector,
    misfit: Misfit,
    slow_share: float,
) -> Bounds:
    """The bounds of a position (3,) by the n satellites in use.

    Their innovations were taken `moved_m` (3,) before it and less frozen offsets (n,);
    `slow_share` is the variance of what lasts of a range over that of its noise.
    """
    factor = misfit.factor
    table = bounded(used, moved_m, offset_m, r_ecef_m, factor, slow_share, level_factors())
    x, y, z, horizontal_m, vertical_m = table.tolist()
    return Bounds(factor, (x, y, z), horizontal_m, vertical_m)


@lru_cache(maxsize=1)
def level_factors(most: int = 128) -> Vector:
    """K (most, 3) by number of hypotheses: no fault, a satellite's, a system's."""
    priors = (1.0, SATELLITE_PRIOR, SYSTEM_PRIOR)
    return np.array(
        [
            [two_sided(min(RISK / (AXES * max(count, 1)) / prior, 1.0)) for prior in priors]
            for count in range(most)
        ]
    )


@compiled
def bounded(
    used: Modelled,
    moved_m: Vector,
    offset_m: Vector,
    r_ecef_m: Vector,
    factor: float,
    slow_share: float,
    factors: Vector,
) -> Vector:
    """Lasting variance in ECEF (3) and the two levels."""
    lat, lon, _ = geodetic(r_ecef_m)
    axes = ned_axes(lat, lon)
    rows = snapshot_rows(used, axes)
    weight = _weights(used, _vertical_m(lat, lon), max(factor, 1.0) * (1.0 + slow_share))
    v, out = np.empty(weight.shape[0]), np.empty(AXES + 2)
    for i in range(v.shape[0]):
        v[i] = used.v_m[i] + offset_m[i]
        for k in range(AXES):
            v[i] -= used.h[i, k] * moved_m[k]
    out[:AXES] = lasting_position_variance(used, rows, axes, factor)
    most = _levels(rows, weight, v, factors)
    out[AXES], out[AXES + 1] = math.hypot(most[0], most[1]), most[2]
    return out


@compiled
def _vertical_m(lat_rad: float, lon_rad: float) -> float:
    """Sigma of the ionosphere in the zenith by geomagnetic latitude."""
    away = 180.0 * abs(geomagnetic_latitude(lat_rad / math.pi, lon_rad / math.pi))
    return VERTICAL_M[0] if away <= 20.0 else VERTICAL_M[1] if away <= 55.0 else VERTICAL_M[2]


@compiled
def _weights(used: Modelled, vertical_m: float, share: float) -> Vector:
    """One over the variance (n,) of a range for integrity."""
    out = np.empty(used.variance.shape[0])
    for i in range(out.shape[0]):
        el = used.elevation_rad[i]
        slant = 1.0 / math.sqrt(1.0 - (6378.1363 * math.cos(el) / (6378.1363 + 350.0)) ** 2)
        bent_m = max(IONOSPHERE_SHARE * used.ionosphere_m[i], slant * vertical_m)
        wet_m = troposphere_m(TROPOSPHERE_M, el)
        out[i] = 1.0 / (share * used.variance[i] + bent_m**2 + wet_m**2 + SIGNAL_M**2)
    return out


@compiled
def _levels(rows: Vector, weight: Vector, v: Vector, factors: Vector) -> Vector:
    """Levels (3,) north, east, down; infinite where a hypothesis cannot be tested."""
    count, size = rows.shape
    systems, of_system = size - AXES, np.zeros(size)
    for i in range(count):
        for k in range(AXES, size):
            of_system[k] += rows[i, k]
    hypotheses = 1 + count + (systems if systems > 1 else 0)
    healthy, single, whole = factors[min(hypotheses, factors.shape[0] - 1)]
    off, cofactor, variance = _snapshot(rows, weight, v)
    most = np.zeros(AXES)
    _widen(most, off, variance, healthy)
    for i in range(count):
        alone = 0
        for k in range(AXES, size):
            alone += rows[i, k] * of_system[k] == 1.0
        # Without it a state would be unseen, but for its own clock: nobody would notice a fault.
        if count - 1 < size - alone:
            most[:] = np.inf
            break
        off_i, variance_i = _without(i, rows, weight, v, off, cofactor)
        _widen(most, off_i, variance_i, single)
    keep = np.empty(count)
    for system in range(AXES, size):
        if systems > 1:
            for i in range(count):
                keep[i] = weight[i] * (1.0 - rows[i, system])
            off_s, _, variance_s = _snapshot(rows, keep, v)
            _widen(most, off_s, variance_s, whole)
    return most


@compiled
def _without(
    i: int, rows: Vector, weight: Vector, v: Vector, off: Vector, cofactor: Vector
) -> tuple[Vector, Vector]:
    """The snapshot of all but one in the first three states, and its covariance's diagonal."""
    size = rows.shape[1]
    g, remaining, own = np.zeros(size), v[i], 1.0
    for k in range(size):
        for j in range(size):
            g[k] += cofactor[k, j] * rows[i, j]
        own -= weight[i] * rows[i, k] * g[k]
        remaining -= rows[i, k] * off[k]
    off_i, variance = np.empty(AXES), np.empty(AXES)
    for k in range(AXES):
        off_i[k] = off[k] - weight[i] * g[k] * remaining / own
        variance[k] = cofactor[k, k] + weight[i] * g[k] * g[k] / own
    return off_i, variance


@compiled
def _widen(most: Vector, off: Vector, variance: Vector, factor: float) -> None:
    """Widen levels (3,), in place, by a snapshot's shift and variances."""
    for q in range(AXES):
        known = 0.0 < variance[q] < WORST_M * WORST_M
        reach = abs(off[q]) + factor * math.sqrt(variance[q]) if known else np.inf
        most[q] = max(most[q], reach)


@compiled
def _snapshot(rows: Vector, weight: Vector, v: Vector) -> tuple[Vector, Vector, Vector]:
    """The snapshot (c,) of those with a weight (n,), from where v (n,) was taken, with its
    covariance (c, c) and that's diagonal; NaN where they are too few."""
    count, size = rows.shape
    normal, b = np.zeros((size, size)), np.zeros(size)
    clocks, remaining = np.zeros(size), 0
    for i in range(count):
        remaining += weight[i] > 0.0
        for k in range(size):
            share = weight[i] * rows[i, k]
            b[k] += share * v[i]
            clocks[k] += abs(share)
            for j in range(size):
                normal[k, j] += share * rows[i, j]
    unknowns = AXES
    for k in range(AXES, size):
        unknowns += clocks[k] > 0.0
        normal[k, k] += UNSEEN
    off, diagonal = np.full(size, np.nan), np.full(size, np.nan)
    if remaining < unknowns:
        return off, np.full((size, size), np.nan), diagonal
    cofactor = inverse(normal)
    for k in range(size):
        off[k], diagonal[k] = 0.0, cofactor[k, k]
        for j in range(size):
            off[k] += cofactor[k, j] * b[j]
    return off, cofactor, diagonal
