"""Errors that last for minutes: the position's covariance beyond the filter's covariance.

They are *considered*, not estimated [1]_: gain and tests stay as they are, and the reported
covariance of the position is f P + S L S' (docs/protection_levels.md).

References
----------
.. [1] S. F. Schmidt, in Advances in Control Systems 3, 1966, p. 293.
.. [2] RTCA DO-229D, A.4.2.5 (troposphere), J.2.3 (ionosphere: a fifth of Klobuchar's delay).
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.information import VAGUE_INFORMATION
from analysis.detection.filter.measurement import Innovations, systems_in_use
from analysis.orbits.broadcast import troposphere_m
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite

LASTING_SIGNAL_M = 0.5  # orbit and clock: what GPS and Galileo reach in the root mean square
IONOSPHERE_SHARE, TROPOSPHERE_M = 0.2, 0.12  # of Klobuchar's delay; of the zenith delay [2]_
FACTOR_MEMORY_S = 60.0  # of the variance factor: multipath changes within a minute
INDEPENDENT_AFTER_S = 1.0  # epochs closer than this share their errors: they count for less
ASSUMED_DOF = 10.0  # prior weight of a factor of 1: about one epoch of 14 satellites
LEAST_FACTOR = 0.25  # no receiver is trusted beyond half the modelled sigma
# North, east, down.
AXES = 3


class VarianceFactor(NamedTuple):
    """Exponentially weighted parity statistics of the last minute, and their degrees of freedom."""

    total: float = ASSUMED_DOF
    dof: float = ASSUMED_DOF

    def with_epoch(self, parity: float, dof: int, dt_s: float) -> "VarianceFactor":
        """The factor after an epoch `dt_s` after the last one."""
        stays, news = math.exp(-dt_s / FACTOR_MEMORY_S), min(dt_s / INDEPENDENT_AFTER_S, 1.0)
        prior = (1.0 - stays) * ASSUMED_DOF
        total = stays * self.total + prior + news * parity
        return VarianceFactor(total, stays * self.dof + prior + news * dof)

    @property
    def factor(self) -> float:
        """The a-posteriori variance factor."""
        return max(self.total / self.dof, LEAST_FACTOR)


@compiled
def lasting_variance(used: Innovations, factor: float) -> Vector:
    """The variance of lasting errors of each range (n,) in m^2."""
    out = np.empty(used.variance.shape[0])
    for i in range(out.shape[0]):
        wet_m = troposphere_m(TROPOSPHERE_M, used.elevation_rad[i])
        out[i] = LASTING_SIGNAL_M**2 + (IONOSPHERE_SHARE * used.ionosphere_m[i]) ** 2 + wet_m**2
        out[i] += max(factor - 1.0, 0.0) * used.variance[i] + used.variance[i] - used.white[i]
    return out


def snapshot_design(h: Vector, axes: Vector) -> Vector:
    """The geometry A (n, 3 + systems) of ranges (n, 20): along the rows of `axes` (3, 3), and a
    clock for each system in use."""
    return np.hstack((h[:, :AXES] @ axes.T, systems_in_use(h)))


@compiled
def snapshot_cofactor(a: Vector, weight: Vector) -> Vector:
    """inv(A'WA) (c, c) for weights (n,)."""
    normal = np.zeros((a.shape[1], a.shape[1]))
    for k in range(a.shape[1]):
        normal[k, k] = VAGUE_INFORMATION
        for i in range(a.shape[0]):
            for j in range(a.shape[1]):
                normal[k, j] += weight[i] * a[i, k] * a[i, j]
    return invert_positive_definite(normal)


def lasting_position_covariance(a: Vector, weight: Vector, lasts: Vector) -> Vector:
    """S L S' (3, 3) along the axes of A (n, c), with weights and lasting variances (n,), in m^2."""
    cofactor = snapshot_cofactor(a, weight)
    response = cofactor[:AXES] @ (a.T * weight)
    return np.asarray((response * lasts) @ response.T)
