"""The filter's update by the usable measurements of an epoch: ranges, then Doppler rates."""

from typing import NamedTuple

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import (
    RATE_STATES,
    NormalEquations,
    add_error,
    reduce_covariance,
)
from analysis.samples.sample import Vector


class EpochUpdate(NamedTuple):
    """The filter after an epoch, the ranges and rates that it used, and P+_:c T (20, c) and F
    (c, c) of each."""

    motion: MotionEstimate
    ranges: NormalEquations
    after_ranges: tuple[Vector, Vector]
    rates: NormalEquations
    after_rates: tuple[Vector, Vector]


def update_filter(
    motion: MotionEstimate, ranges: NormalEquations, rates: NormalEquations
) -> EpochUpdate:
    """The filter after some ranges and rates, both with innovations against `motion`."""
    p, after_ranges, moved = reduce_covariance(motion.p, ranges)
    # The ranges have moved the state that the rates were predicted for.
    rates = rates._replace(b=rates.b - rates.information @ moved[RATE_STATES])
    p, after_rates, moved_again = reduce_covariance(p, rates)
    motion = motion._replace(x=add_error(add_error(motion.x, moved), moved_again), p=p)
    return EpochUpdate(motion, ranges, after_ranges, rates, after_rates)
