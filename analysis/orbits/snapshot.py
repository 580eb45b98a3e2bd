"""The geometry of a single epoch (snapshot): position, clock, inter-system biases."""

import numpy as np
from numpy.typing import NDArray

from analysis.samples.sample import Vector

Indices = NDArray[np.int64]


def systems_of(system: Indices) -> list[int]:
    """The distinct systems in `system` (n,), by `broadcast.CLOCK_OF`; the first has no bias."""
    return sorted(set(system.tolist()))


def design_matrix(los: Vector, system: Indices) -> Vector:
    """Geometry matrix (n, 3 + systems): negative lines of sight, clock, inter-system biases."""
    columns = [-los, np.ones((len(los), 1))]
    columns += [(system == kind)[:, None].astype(float) for kind in systems_of(system)[1:]]
    return np.hstack(columns)
