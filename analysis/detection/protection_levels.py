"""Protection levels: how far the position may be off at a stated integrity risk.

By solution separation, as in advanced RAIM [1]_, about the detector's own position;
docs/protection_levels.md says what they assume. A satellite's snapshot is a change of rank one [2]_
of that of all, x with C = inv(A'WA): with g = C a,

    C_k = C + w g g' / (1 - w a'g),   x_k = x - w g (v - a'x) / (1 - w a'g).

References
----------
.. [1] Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51(1), 2015.
.. [2] Golub and Van Loan, Matrix Computations, 4th ed., 2013, 2.1.4.
.. [3] RTCA DO-229D, J.2.3: by geomagnetic latitude.
"""

import math
from bisect import bisect_left
from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.lasting_errors import (
    AXES,
    IONOSPHERE_SHARE,
    TROPOSPHERE_M,
    VarianceFactor,
    lasting_position_covariance,
    lasting_variance,
    snapshot_cofactor,
    snapshot_design,
)
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations
from analysis.detection.statistics.chi_square import two_sided_bound
from analysis.orbits.broadcast import geomagnetic_latitude, troposphere_m
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

INTEGRITY_RISK = 1e-7  # per epoch, of an error beyond a level without an alarm [1]_
SATELLITE_PRIOR, SYSTEM_PRIOR = 1e-5, 1e-4  # of an unannounced fault [1]_
INTEGRITY_SIGNAL_M = 1.0  # sigma of orbit and clock for integrity [1]_
# Of the vertical ionosphere up to each latitude, and beyond [3]_.
ZENITH_IONOSPHERE_M, ZENITH_LATITUDES = (9.0, 4.5, 6.0), (20.0, 55.0)
MOST_HYPOTHESES = 128  # satellites and systems in use
# What a level assumes, by the number of systems in use.
ONE_SYSTEM, SEVERAL_SYSTEMS = (
    "at most one satellite is wrong",
    "at most one satellite or system is wrong",
)


class PositionBounds(NamedTuple):
    """The bounds of a position: the variance factor of its noise, the covariance of lasting errors
    (3, 3) in ECEF, and the protection levels, infinite where a fault would not be observable."""

    factor: float
    lasting_m2: Vector
    hpl_m: float
    vpl_m: float


def bound_position(
    used: Innovations,
    moved_m: Vector,
    offset_m: Vector,
    r_ecef_m: Vector,
    misfit: VarianceFactor,
    slow_share: float,
    rivals: Innovations = NO_INNOVATIONS,
) -> PositionBounds:
    """The bounds of a position (3,) by the n satellites in use.

    Their innovations were taken `moved_m` (3,) before it and less frozen offsets (n,);
    `slow_share` is the variance of lasting range errors over that of noise. The satellites `rivals`
    contradict those, and may as well be right: the levels cover their position too, and the
    covariance is that of either position with the same probability.
    """
    factor = misfit.factor
    lat, lon, _ = geodetic_position(r_ecef_m)
    share = max(factor, 1.0) * (1.0 + slow_share)
    axes, lasts = ned_axes(lat, lon), lasting_variance(used, factor)
    a = snapshot_design(used.geometry, axes)
    lasting_m2 = lasting_position_covariance(a, 1.0 / used.variance, lasts)
    count, factors = len(used.range_m), level_factors()
    used = used._replace(range_m=used.range_m + offset_m)
    if len(rivals.range_m):
        used = Innovations(*map(np.concatenate, zip(used, rivals, strict=True)))
        # A system is wrong, so its prior is 1.
        a = snapshot_design(used.geometry, axes)
        factors = np.ascontiguousarray(factors[:, [0, 1, 0]])
    weight = _weights(used, _zenith_ionosphere_m(lat, lon), share)
    v = used.range_m - used.geometry[:, :AXES] @ moved_m
    if len(rivals.range_m):
        alone = snapshot_design(rivals.geometry, axes)
        off_m = _snapshot(alone, weight[count:], v[count:])[0][:AXES]
        lasting_m2 += 0.5 * np.outer(off_m, off_m)
    levels_m = _levels(a, weight, v, factors)
    north_m, east_m, vertical_m = levels_m.tolist()
    return PositionBounds(
        factor, axes.T @ lasting_m2 @ axes, math.hypot(north_m, east_m), vertical_m
    )


def level_assumptions(names: Iterable[str]) -> str:
    """The assumptions of the protection levels by some satellites, as text."""
    systems = {name[0] for name in names} - {"J"}  # QZSS counts as GPS
    return SEVERAL_SYSTEMS if len(systems) > 1 else ONE_SYSTEM


@cache
def level_factors(most: int = MOST_HYPOTHESES) -> Vector:
    """K (most, 3) by number of hypotheses: no fault, a satellite's, a system's."""
    priors = (1.0, SATELLITE_PRIOR, SYSTEM_PRIOR)
    return np.array(
        [
            [
                two_sided_bound(min(INTEGRITY_RISK / (AXES * max(count, 1)) / prior, 1.0))
                for prior in priors
            ]
            for count in range(most)
        ]
    )


def _zenith_ionosphere_m(lat_rad: float, lon_rad: float) -> float:
    """Sigma of the ionosphere in the zenith by geomagnetic latitude."""
    away = 180.0 * abs(geomagnetic_latitude(lat_rad / math.pi, lon_rad / math.pi))
    return ZENITH_IONOSPHERE_M[bisect_left(ZENITH_LATITUDES, away)]


@compiled
def _weights(used: Innovations, zenith_m: float, share: float) -> Vector:
    """One over the variance (n,) of a range for integrity."""
    out = np.empty(used.variance.shape[0])
    for i in range(out.shape[0]):
        el = used.elevation_rad[i]
        slant = 1.0 / math.sqrt(1.0 - (6378.1363 * math.cos(el) / (6378.1363 + 350.0)) ** 2)
        bent_m = max(IONOSPHERE_SHARE * used.ionosphere_m[i], slant * zenith_m)
        wet_m = troposphere_m(TROPOSPHERE_M, el)
        out[i] = 1.0 / (share * used.variance[i] + bent_m**2 + wet_m**2 + INTEGRITY_SIGNAL_M**2)
    return out


@compiled
def _levels(a: Vector, weight: Vector, v: Vector, factors: Vector) -> Vector:
    """Levels (3,) along the axes of A (n, c); infinite where a hypothesis cannot be tested."""
    count, unknowns = a.shape
    members, keep, g = np.zeros(unknowns), weight.copy(), np.empty(unknowns)
    for i in range(count):
        for k in range(AXES, unknowns):
            members[k] += a[i, k]
    systems = unknowns - AXES if unknowns > AXES + 1 else 0
    healthy, single, entire = factors[min(1 + count + systems, factors.shape[0] - 1)]
    off, cofactor = _snapshot(a, weight, v)
    most = np.zeros(AXES)
    for k in range(AXES):
        _widen(most, k, off[k], cofactor[k, k], healthy)
    for i in range(count):
        own, remaining, alone = 1.0, v[i], 0
        for k in range(unknowns):
            g[k] = 0.0
            for j in range(unknowns):
                g[k] += cofactor[k, j] * a[i, j]
            own -= weight[i] * a[i, k] * g[k]
            remaining -= a[i, k] * off[k]
            alone += k >= AXES and a[i, k] == 1.0 and members[k] == 1.0
        for k in range(AXES):
            shift, variance = weight[i] * g[k] / own, weight[i] * g[k] * g[k] / own
            _widen(most, k, off[k] - shift * remaining, cofactor[k, k] + variance, single)
        # Without it a state, other than its own clock, is unobserved: a fault would go undetected.
        if count - 1 < unknowns - alone:
            most[:] = np.inf
    for system in range(AXES, AXES + systems):
        for i in range(count):
            keep[i] = weight[i] * (1.0 - a[i, system])
        off, cofactor = _snapshot(a, keep, v)
        for k in range(AXES):
            _widen(most, k, off[k], cofactor[k, k], entire)
        if count - members[system] < unknowns - 1:
            most[:] = np.inf
    return most


@inlined
def _widen(most: Vector, k: int, off_m: float, variance: float, factor: float) -> None:
    """Widen the level of an axis by a snapshot's shift and variance."""
    level_m = abs(off_m) + factor * math.sqrt(variance) if variance > 0.0 else np.inf
    most[k] = max(most[k], level_m)


@compiled
def _snapshot(a: Vector, weight: Vector, v: Vector) -> tuple[Vector, Vector]:
    """The snapshot (c,) of those with a weight (n,), from where v (n,) was taken, with its
    covariance (c, c)."""
    cofactor = snapshot_cofactor(a, weight)
    b, off = np.zeros(a.shape[1]), np.zeros(a.shape[1])
    for k in range(a.shape[1]):
        for i in range(a.shape[0]):
            b[k] += weight[i] * a[i, k] * v[i]
    for k in range(a.shape[1]):
        for j in range(a.shape[1]):
            off[k] += cofactor[k, j] * b[j]
    return off, cofactor
