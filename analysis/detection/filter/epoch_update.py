"""The filter's update by the usable measurements of an epoch: ranges, then Doppler rates."""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import (
    RATE_STATES,
    NormalEquations,
    add_error,
    reduce_covariance,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled


class EpochUpdate(NamedTuple):
    """The filter after an epoch, the ranges and rates that it used, and the columns P+_:c (20, c)
    of its covariance after each."""

    motion: MotionEstimate
    ranges: NormalEquations
    after_ranges: Vector
    rates: NormalEquations
    after_rates: Vector


def update_filter(
    motion: MotionEstimate, ranges: NormalEquations, rates: NormalEquations
) -> EpochUpdate:
    """The filter after some ranges and rates, both with innovations against `motion`."""
    p, after_ranges, after_rates, moves, b = _reduced(motion.p, ranges, rates)
    motion = motion._replace(x=add_error(add_error(motion.x, moves[0]), moves[1]), p=p)
    return EpochUpdate(motion, ranges, after_ranges, rates._replace(b=b), after_rates)


@compiled
def _reduced(
    p: Vector, ranges: NormalEquations, rates: NormalEquations
) -> tuple[Vector, Vector, Vector, tuple[Vector, Vector], Vector]:
    """The covariance, P+_:c of both, dx (20,) of both, and b (4,) of the rates after the ranges
    have moved the state."""
    p, after_ranges, moved = reduce_covariance(p, ranges)
    b, moved_again = rates.b.copy(), np.zeros(p.shape[0])
    for i in range(b.shape[0]):
        for j in range(b.shape[0]):
            b[i] -= rates.information[i, j] * moved[RATE_STATES[j]]
    p, after_rates, _ = reduce_covariance(p, rates)
    for i in range(p.shape[0]):
        for j in range(b.shape[0]):
            moved_again[i] += after_rates[i, j] * b[j]
    return p, after_ranges, after_rates, (moved, moved_again), b
