"""The filter's update by the usable measurements of an epoch: ranges, then Doppler rates."""

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import (
    RATE_STATES,
    NormalEquations,
    covariance_block,
    normal_equations,
    posterior_block,
    rate_equations,
    update_in_place,
)
from analysis.detection.filter.measurement import Innovations, RateInnovations
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled


def update_filter(
    motion: MotionEstimate, ranges: Innovations, rates: RateInnovations
) -> MotionEstimate:
    """The filter after some ranges and rates."""
    x, p = _updated(motion.x, motion.p, ranges, rates)
    return motion._replace(x=x, p=p)


@compiled
def _updated(
    x: Vector, p: Vector, ranges: Innovations, rates: RateInnovations
) -> tuple[Vector, Vector]:
    """The state x (21,) and its covariance p (20, 20) after an epoch, as new arrays."""
    x, p = x.copy(), p.copy()
    normal = normal_equations(ranges.geometry, ranges.variance, ranges.range_m)
    y = posterior_block(covariance_block(p, normal.states), normal.information)[1]
    moved = update_in_place(x, p, normal, y)[1]
    update_by_rates(x, p, rate_equations(rates.geometry, rates.variance, rates.rate_mps), moved)
    return x, p


@compiled
def update_by_rates(x: Vector, p: Vector, rates: NormalEquations, moved: Vector) -> Vector:
    """Update x, p and the rates' b in place after the ranges moved the state by `moved` (20,);
    returns P+_:c (20, 4)."""
    b, information = rates.b, rates.information
    for i in range(b.shape[0]):  # the innovations are against the state before the ranges
        for j in range(b.shape[0]):
            b[i] -= information[i, j] * moved[RATE_STATES[j]]
    y = posterior_block(covariance_block(p, rates.states), information)[1]
    return update_in_place(x, p, rates, y)[0]
