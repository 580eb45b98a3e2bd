"""The filter and its ramp tests after an epoch, in one call."""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.epoch_update import update_by_rates
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import (
    covariance_block,
    normal_equations,
    posterior_block,
    rate_equations,
    update_in_place,
)
from analysis.detection.filter.measurement import Innovations, RateInnovations
from analysis.detection.isolation.ramp_test import RampBank
from analysis.detection.isolation.ramp_windows import (
    RampNumbers,
    RampWindows,
    StrongestRamp,
    learn_offsets,
    respond_to_ranges,
    respond_to_rates,
    strongest_ramp,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

UpdatedArrays = tuple[Vector, Vector, Vector, Vector, Vector, Vector]


class EpochStep(NamedTuple):
    """From the last epoch to this one: the transition (20, 20) of errors, the time between them,
    the stamp, and whether the IMU propagated the filter."""

    transition: Vector
    dt_s: float
    t_us: int
    inertial: bool


def update_with_ramps(
    motion: MotionEstimate,
    ranges: Innovations,
    rates: RateInnovations,
    ramps: RampBank,
    step: EpochStep,
    numbers: RampNumbers,
) -> tuple[MotionEstimate, RampBank, StrongestRamp]:
    """The filter and its ramp tests after an epoch, and the strongest ramp that these show now.

    `ramps` are over the satellites of `ranges`.
    """
    arrays, strongest = _updated_with_ramps(
        motion.x, motion.p, ranges, rates, step, ramps.windows, numbers
    )
    x, p, d, sums, offset, spread = arrays
    windows = ramps.windows._replace(d=d, sums=sums, offset=offset, spread=spread)
    return motion._replace(x=x, p=p), ramps._replace(windows=windows), strongest


@compiled
def _updated_with_ramps(
    x: Vector,
    p: Vector,
    ranges: Innovations,
    rates: RateInnovations,
    step: EpochStep,
    windows: RampWindows,
    numbers: RampNumbers,
) -> tuple[UpdatedArrays, StrongestRamp]:
    """x (21,) and p (20, 20), with d, sums, offset and spread of the ramp tests' windows, after an
    epoch, as new arrays, and the strongest ramp."""
    normal = normal_equations(ranges.geometry, ranges.variance, ranges.range_m)
    # The covariance before the update: `learn_offsets` needs it after `p` has changed.
    prior = covariance_block(p, normal.states)
    y = posterior_block(prior, normal.information)[1]
    rate = rate_equations(rates.geometry, rates.variance, rates.rate_mps)
    x, p = x.copy(), p.copy()
    after, moved = update_in_place(x, p, normal, y)
    after_rates = update_by_rates(x, p, rate, moved)
    starts_us = windows.starts_us
    ages = np.zeros(starts_us.shape[0])
    for w in range(ages.shape[0]):
        # 0 marks a window that has not begun; its age stays zero.
        if starts_us[w] != 0:
            ages[w] = (step.t_us - starts_us[w]) * 1e-6
    d, sums = respond_to_ranges(windows, ages, step.transition, after, normal, step.dt_s)
    respond_to_rates(d, sums, after_rates, rate)
    offset, spread = learn_offsets(windows, prior, normal, step.dt_s, numbers)
    now = RampWindows(starts_us, d, sums, offset, spread, windows.offsets, windows.spreads)
    return (x, p, d, sums, offset, spread), strongest_ramp(now, ages, step.inertial, numbers)
