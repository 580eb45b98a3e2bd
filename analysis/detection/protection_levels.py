"""Protection levels: how far the position may be off at a stated integrity risk.

By solution separation, as in advanced RAIM [1]_, about the detector's own position: whichever
satellite, or entire system, may have an undetected fault, the snapshot that does not use it bounds
the truth. With d_k the distance from the position to that snapshot and sigma_k what the
snapshot's error may be without a fault,

    level = max over k of |d_k| + K_k sigma_k,   Q(K_k) = risk / (3 axes, hypotheses, prior of k)

No sigma of the filter is used. A hypothesis that leaves too few satellites makes the level unknown;
a fault of the only system in use is not observable and not covered, nor is one of all systems
together: each decision with levels says what they assume. With C = inv(A'WA)
and g = C a, a satellite's snapshot is a change of rank one [2]_:

    C_k = C + w g g' / (1 - w a'g),   x_k = x - w g (v - a'x) / (1 - w a'g).

References
----------
.. [1] Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51(1), 2015.
.. [2] Golub and Van Loan, Matrix Computations, 4th ed., 2013, 2.1.4.
.. [3] RTCA DO-229D, J.2.3: by geomagnetic latitude.
"""

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.lasting_errors import (
    AXES,
    IONOSPHERE_SHARE,
    TROPOSPHERE_M,
    RangeGeometry,
    VarianceFactor,
    lasting_position_covariance,
    normal_matrix,
    range_geometry,
)
from analysis.detection.filter.measurement import Innovations
from analysis.detection.statistics.chi_square import two_sided_bound
from analysis.orbits.broadcast import geomagnetic_latitude, troposphere_m
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.linear import invert_positive_definite

INTEGRITY_RISK = 1e-7  # per epoch, of an error beyond a level without an alarm [1]_
SATELLITE_PRIOR, SYSTEM_PRIOR = 1e-5, 1e-4  # of an unannounced fault [1]_
INTEGRITY_SIGNAL_M = 1.0  # sigma of orbit and clock for integrity [1]_
# Of the vertical ionosphere up to 20 degrees, up to 55 and beyond [3]_.
ZENITH_IONOSPHERE_M = 9.0, 4.5, 6.0
# What a level assumes, by the number of systems in use.
ONE_SYSTEM, SEVERAL_SYSTEMS = (
    "at most one satellite is wrong",
    "at most one satellite or system is wrong",
)
UNSEEN_INFORMATION = 1e-9  # 1/m^2: keeps N regular where a system has no satellite left
LARGEST_LEVEL_M = 1e4  # a larger level is reported as none


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
) -> PositionBounds:
    """The bounds of a position (3,) by the n satellites in use.

    Their innovations were taken `moved_m` (3,) before it and less frozen offsets (n,);
    `slow_share` is the variance of lasting range errors over that of noise.
    """
    factor = misfit.factor
    lasting_m2, most = bounds_kernel(
        used, moved_m, offset_m, r_ecef_m, factor, slow_share, level_factors()
    )
    north_m, east_m, vertical_m = most.tolist()
    return PositionBounds(factor, lasting_m2, math.hypot(north_m, east_m), vertical_m)


def level_assumptions(names: Iterable[str]) -> str:
    """The assumptions of the protection levels by some satellites, as text."""
    systems = {name[0] for name in names} - {"J"}  # QZSS counts as GPS
    return SEVERAL_SYSTEMS if len(systems) > 1 else ONE_SYSTEM


@lru_cache(maxsize=1)
def level_factors(most: int = 128) -> Vector:
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


@compiled
def bounds_kernel(
    used: Innovations,
    moved_m: Vector,
    offset_m: Vector,
    r_ecef_m: Vector,
    factor: float,
    slow_share: float,
    factors: Vector,
) -> tuple[Vector, Vector]:
    """Lasting covariance (3, 3) in ECEF, and the levels (3,) north, east, down."""
    lat, lon, _ = geodetic_position(r_ecef_m)
    axes = ned_axes(lat, lon)
    geometry = range_geometry(used, axes)
    weight = _weights(used, _vertical_m(lat, lon), max(factor, 1.0) * (1.0 + slow_share))
    v = np.empty(weight.shape[0])
    for i in range(v.shape[0]):
        v[i] = used.range_m[i] + offset_m[i]
        for k in range(AXES):
            v[i] -= used.geometry[i, k] * moved_m[k]
    lasting_m2 = lasting_position_covariance(used, geometry, axes, factor)
    return lasting_m2, _levels(geometry, weight, v, factors)


@compiled
def _vertical_m(lat_rad: float, lon_rad: float) -> float:
    """Sigma of the ionosphere in the zenith by geomagnetic latitude."""
    away = 180.0 * abs(geomagnetic_latitude(lat_rad / math.pi, lon_rad / math.pi))
    return (
        ZENITH_IONOSPHERE_M[0]
        if away <= 20.0
        else ZENITH_IONOSPHERE_M[1]
        if away <= 55.0
        else ZENITH_IONOSPHERE_M[2]
    )


@compiled
def _weights(used: Innovations, vertical_m: float, share: float) -> Vector:
    """One over the variance (n,) of a range for integrity."""
    out = np.empty(used.variance.shape[0])
    for i in range(out.shape[0]):
        el = used.elevation_rad[i]
        slant = 1.0 / math.sqrt(1.0 - (6378.1363 * math.cos(el) / (6378.1363 + 350.0)) ** 2)
        bent_m = max(IONOSPHERE_SHARE * used.ionosphere_m[i], slant * vertical_m)
        wet_m = troposphere_m(TROPOSPHERE_M, el)
        out[i] = 1.0 / (share * used.variance[i] + bent_m**2 + wet_m**2 + INTEGRITY_SIGNAL_M**2)
    return out


@compiled
def _levels(geometry: RangeGeometry, weight: Vector, v: Vector, factors: Vector) -> Vector:
    """Levels (3,) north, east, down; infinite where a hypothesis cannot be tested."""
    count, unknowns = v.shape[0], geometry.unknowns
    systems, of_system = unknowns - AXES, np.zeros(unknowns, np.int64)
    for i in range(count):
        of_system[geometry.clock[i]] += 1
    hypotheses = 1 + count + (systems if systems > 1 else 0)
    healthy, single, entire = factors[min(hypotheses, factors.shape[0] - 1)]
    off, cofactor = _snapshot(geometry, weight, v)
    most = np.zeros(AXES)
    for k in range(AXES):
        _widen(most, k, off[k], cofactor[k, k], healthy)
    for i in range(count):
        # Without it a state, other than its own clock, is unobserved: a fault would go undetected.
        if count - 1 < unknowns - (of_system[geometry.clock[i]] == 1):
            most[:] = np.inf
            break
        _widen_without(most, i, geometry, weight, v, off, cofactor, single)
    keep = np.empty(count)
    for system in range(AXES, unknowns if systems > 1 else AXES):
        for i in range(count):
            keep[i] = 0.0 if geometry.clock[i] == system else weight[i]
        off, cofactor = _snapshot(geometry, keep, v)
        for k in range(AXES):
            _widen(most, k, off[k], cofactor[k, k], entire)
    return most


@compiled
def _widen_without(
    most: Vector,
    i: int,
    geometry: RangeGeometry,
    weight: Vector,
    v: Vector,
    off: Vector,
    cofactor: Vector,
    factor: float,
) -> None:
    """Widen levels (3,), in place, by the snapshot of all ranges but one."""
    w, at = weight[i], geometry.clock[i]
    x, y, z = (
        geometry.line_of_sight[i, 0],
        geometry.line_of_sight[i, 1],
        geometry.line_of_sight[i, 2],
    )
    north = cofactor[0, 0] * x + cofactor[0, 1] * y + cofactor[0, 2] * z + cofactor[0, at]
    east = cofactor[1, 0] * x + cofactor[1, 1] * y + cofactor[1, 2] * z + cofactor[1, at]
    down = cofactor[2, 0] * x + cofactor[2, 1] * y + cofactor[2, 2] * z + cofactor[2, at]
    clock = cofactor[at, 0] * x + cofactor[at, 1] * y + cofactor[at, 2] * z + cofactor[at, at]
    own = 1.0 - w * (x * north + y * east + z * down + clock)
    remaining = v[i] - x * off[0] - y * off[1] - z * off[2] - off[at]
    for k, g in enumerate((north, east, down)):
        variance = cofactor[k, k] + w * g * g / own
        _widen(most, k, off[k] - w * g * remaining / own, variance, factor)


@inlined
def _widen(most: Vector, k: int, off_m: float, variance: float, factor: float) -> None:
    """Widen the level of an axis by a snapshot's shift and variance."""
    known = 0.0 < variance < LARGEST_LEVEL_M * LARGEST_LEVEL_M
    most[k] = max(most[k], abs(off_m) + factor * math.sqrt(variance) if known else np.inf)


@compiled
def _snapshot(geometry: RangeGeometry, weight: Vector, v: Vector) -> tuple[Vector, Vector]:
    """The snapshot (c,) of those with a weight (n,), from where v (n,) was taken, with its
    covariance (c, c); NaN where they are too few."""
    unknowns, remaining = geometry.unknowns, 0
    b, observed = np.zeros(unknowns), np.zeros(unknowns, np.bool_)
    for i in range(v.shape[0]):
        remaining += weight[i] > 0.0
        observed[geometry.clock[i]] |= weight[i] > 0.0
        b[geometry.clock[i]] += weight[i] * v[i]
        for k in range(AXES):
            b[k] += weight[i] * geometry.line_of_sight[i, k] * v[i]
    if remaining < AXES + observed.sum():
        return np.full(unknowns, np.nan), np.full((unknowns, unknowns), np.nan)
    normal = normal_matrix(geometry, weight)
    for k in range(AXES, unknowns):
        normal[k, k] += UNSEEN_INFORMATION
    cofactor, off = invert_positive_definite(normal), np.zeros(unknowns)
    for k in range(unknowns):
        for j in range(unknowns):
            off[k] += cofactor[k, j] * b[j]
    return off, cofactor
