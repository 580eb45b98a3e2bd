"""Errors that last for minutes: what they make of the position beyond the filter's covariance.

A filter that takes epochs as independent averages its noise away, but not multipath, orbit and
clock errors, and what the ionosphere's and the troposphere's models leave: these are the same at
the next epoch. They are *considered*, not estimated [1]_: gain and tests stay as they are, and the
covariance that is told of the position is

    f P + S L S',   S = inv(A'WA) A'W,

S the snapshot's response to the ranges, which the filter reaches within seconds, L (diagonal) the
variances of what lasts, and f the a-posteriori variance factor: chi-square per degree of freedom of
the parity test over the last minute. Where it is above 1 the excess is multipath, and lasts.

References
----------
.. [1] S. F. Schmidt, in Advances in Control Systems 3, 1966, p. 293.
.. [2] RTCA DO-229D, A.4.2.5 (troposphere), J.2.3 (ionosphere: a fifth of Klobuchar's delay).
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.inertial import ISB
from analysis.detection.filter.measurement import Innovations
from analysis.orbits.broadcast import CLOCKS, troposphere_m
from analysis.samples.block import Indices
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite

LASTING_SIGNAL_M = 0.5  # orbit and clock: what GPS and Galileo reach in the root mean square
IONOSPHERE_SHARE, TROPOSPHERE_M = 0.2, 0.12  # of Klobuchar's delay; of the zenith delay [2]_
FACTOR_MEMORY_S = 60.0  # of the variance factor
INDEPENDENT_AFTER_S = 1.0  # epochs closer than this share their errors
ASSUMED_DOF = 10.0  # degrees of freedom in favour of the model as it is
LEAST_FACTOR = 0.25
AXES = 3
VAGUE_INFORMATION = 1e-4  # information in 1/m^2 of where an antenna is that too few satellites see


class VarianceFactor(NamedTuple):
    """Parity statistics of the last minute and their degrees of freedom, the older the less."""

    total: float = ASSUMED_DOF
    dof: float = ASSUMED_DOF

    def with_epoch(self, parity: float, dof: int, dt_s: float) -> "VarianceFactor":
        """After an epoch `dt_s` after the last."""
        return VarianceFactor(*update_variance_factor(self.total, self.dof, parity, dof, dt_s))

    @property
    def factor(self) -> float:
        """The a-posteriori variance factor."""
        return max(self.total / self.dof, LEAST_FACTOR)


@compiled
def update_variance_factor(
    total: float, known: float, parity: float, dof: int, dt_s: float
) -> tuple[float, float]:
    """The fields of a `VarianceFactor` after an epoch."""
    stays, news = math.exp(-dt_s / FACTOR_MEMORY_S), min(dt_s / INDEPENDENT_AFTER_S, 1.0)
    fresh = (1.0 - stays) * ASSUMED_DOF
    return stays * total + fresh + news * parity, stays * known + fresh + news * dof


class RangeGeometry(NamedTuple):
    """The geometry of a snapshot by n ranges: unit vectors by some axes (n, 3), and where among the
    `unknowns` the clock of each one's system is (n,), behind the position."""

    line_of_sight: Vector
    clock: Indices
    unknowns: int


@compiled
def range_geometry(used: Innovations, axes: Vector) -> RangeGeometry:
    """The geometry by the rows of `axes` (3, 3), with a clock for each system that is in use."""
    count, h = used.geometry.shape[0], used.geometry
    sight, clock = np.zeros((count, AXES)), np.empty(count, np.int64)
    # The last place is GPS's, whose clock is the filter's own.
    place, unknowns = np.full(CLOCKS, -1), AXES
    for i in range(count):
        system = CLOCKS - 1
        for k in range(CLOCKS - 1):
            if h[i, ISB + k] != 0.0:
                system = k
        if place[system] < 0:
            place[system] = unknowns
            unknowns += 1
        clock[i] = place[system]
        for k in range(AXES):
            for j in range(AXES):
                sight[i, k] += axes[k, j] * h[i, j]
    return RangeGeometry(sight, clock, unknowns)


@compiled
def normal_matrix(lines: RangeGeometry, weight: Vector) -> Vector:
    """A'WA (c, c) for weights (n,)."""
    sight, clock, unknowns = lines
    out = np.zeros((unknowns, unknowns))
    for i in range(sight.shape[0]):
        w, at = weight[i], clock[i]
        for k in range(AXES):
            for j in range(k + 1):
                out[k, j] += w * sight[i, k] * sight[i, j]
            out[at, k] += w * sight[i, k]
        out[at, at] += w
    for k in range(unknowns):
        for j in range(k):
            out[j, k] = out[k, j]
    return out


@compiled
def lasting_variance(used: Innovations, factor: float) -> Vector:
    """Variance (n,) in m^2 of the lasting error of each range."""
    out = np.empty(used.variance.shape[0])
    for i in range(out.shape[0]):
        wet_m = troposphere_m(TROPOSPHERE_M, used.elevation_rad[i])
        out[i] = LASTING_SIGNAL_M**2 + (IONOSPHERE_SHARE * used.ionosphere_m[i]) ** 2 + wet_m**2
        out[i] += max(factor - 1.0, 0.0) * used.variance[i]
    return out


@compiled
def lasting_position_variance(
    used: Innovations, lines: RangeGeometry, axes: Vector, factor: float
) -> Vector:
    """The diagonal (3,) of S L S' in ECEF, m^2, of a geometry by the rows of `axes` (3, 3)."""
    lasts, weight = lasting_variance(used, factor), 1.0 / used.variance
    normal = normal_matrix(lines, weight)
    for k in range(lines.unknowns):
        normal[k, k] += VAGUE_INFORMATION  # directions that nobody sees must not make it singular
    cofactor, out, response = invert_positive_definite(normal), np.zeros(AXES), np.empty(AXES)
    for i in range(weight.shape[0]):
        for k in range(AXES):
            response[k] = cofactor[k, lines.clock[i]]
            for j in range(AXES):
                response[k] += cofactor[k, j] * lines.line_of_sight[i, j]
        for k in range(AXES):
            moved = 0.0
            for j in range(AXES):
                moved += axes[j, k] * response[j]
            out[k] += moved * moved * lasts[i] * weight[i] * weight[i]
    return out
