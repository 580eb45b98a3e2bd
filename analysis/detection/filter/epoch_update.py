"""What an epoch does to the filter and to its ramp tests, in one call, once it is known what to
trust.

The ranges are used first, then the Doppler rates against what the ranges have changed.
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig, RampNumbers
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import (
    NormalEquations,
    covariance_block,
    normal_equations,
    posterior_block,
    update_in_place,
)
from analysis.detection.filter.measurement import Innovations
from analysis.detection.isolation.assessment import RATE_STATES, rate_equations
from analysis.detection.isolation.ramp_test import RampBank
from analysis.detection.isolation.ramp_windows import (
    RampWindows,
    StrongestRamp,
    learn_offsets,
    respond_to_ranges,
    respond_to_rates,
    strongest_ramp,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

CommittedArrays = tuple[Vector, Vector, Vector, Vector, Vector, Vector]


class RateInnovations(NamedTuple):
    """Doppler rates that fit, NaN where one does not: v and variance (n,), geometry of the ranges
    of the same satellites (n, 20)."""

    v: Vector
    variance: Vector
    h: Vector


class EpochStep(NamedTuple):
    """From the last epoch to this one: the transition phi (20, 20), the time between them, the
    stamp, and whether the IMU moved the filter."""

    phi: Vector
    dt_s: float
    t_us: int
    inertial: bool


def absorb_epoch(
    motion: MotionEstimate, ranges: Innovations, rates: RateInnovations
) -> MotionEstimate:
    """The filter after some ranges and rates."""
    x, p = _absorbed(motion.x, motion.p, ranges, rates)
    return motion._replace(x=x, p=p)


def commit_epoch(
    motion: MotionEstimate,
    ranges: Innovations,
    rates: RateInnovations,
    ramps: RampBank,
    step: EpochStep,
    config: DetectorConfig,
) -> tuple[MotionEstimate, RampBank, StrongestRamp]:
    """The filter after an epoch, its ramp tests after it, and what stands out in these now.

    `ramps` are over the satellites of `ranges`.
    """
    after, found = _committed(
        motion.x, motion.p, ranges, rates, step, ramps.windows, config.ramp_numbers
    )
    x, p, d, sums, offset, spread = after
    windows = ramps.windows._replace(d=d, sums=sums, offset=offset, spread=spread)
    return motion._replace(x=x, p=p), ramps._replace(windows=windows), found


@compiled
def _absorbed(
    x: Vector, p: Vector, ranges: Innovations, rates: RateInnovations
) -> tuple[Vector, Vector]:
    """The state x (21,) and its covariance p (20, 20) after an epoch, as new arrays."""
    x, p = x.copy(), p.copy()
    normal = normal_equations(ranges.h, ranges.variance, ranges.v_m)
    moved = update_in_place(
        x, p, normal, posterior_block(covariance_block(p, normal.states), normal.information)[1]
    )[1]
    _absorb_rates(x, p, rate_equations(rates.h, rates.variance, rates.v), moved)
    return x, p


@compiled
def _absorb_rates(x: Vector, p: Vector, rates: NormalEquations, moved: Vector) -> Vector:
    """Update x, p and the rates' b in place after the ranges moved the state by `moved` (20,);
    returns P+_:c (20, 4)."""
    b, information = rates.b, rates.information
    for i in range(b.shape[0]):  # what the ranges have changed is no news
        for j in range(b.shape[0]):
            b[i] -= information[i, j] * moved[RATE_STATES[j]]
    return update_in_place(
        x, p, rates, posterior_block(covariance_block(p, rates.states), information)[1]
    )[0]


@compiled
def _committed(
    x: Vector,
    p: Vector,
    ranges: Innovations,
    rates: RateInnovations,
    step: EpochStep,
    windows: RampWindows,
    numbers: RampNumbers,
) -> tuple[CommittedArrays, StrongestRamp]:
    """What `commit_kernel` gives of ranges and rates that are not yet normal equations."""
    normal = normal_equations(ranges.h, ranges.variance, ranges.v_m)
    y = posterior_block(covariance_block(p, normal.states), normal.information)[1]
    rate = rate_equations(rates.h, rates.variance, rates.v)
    return commit_kernel(x, p, normal, y, rate, step, windows, numbers)


@compiled
def commit_kernel(
    x: Vector,
    p: Vector,
    ranges: NormalEquations,
    y: Vector,
    rates: NormalEquations,
    step: EpochStep,
    windows: RampWindows,
    numbers: RampNumbers,
) -> tuple[CommittedArrays, StrongestRamp]:
    """x (21,) and p (20, 20), with d, sums, offset and spread of the ramp tests' windows, after an
    epoch, as new arrays, and what stands out in these; `y` (c, c) is Y of the ranges, and b of the
    rates changes in place."""
    # The covariance before the update: `learn_offsets` needs it after `p` has changed.
    prior = covariance_block(p, ranges.states)
    x, p = x.copy(), p.copy()
    after, moved = update_in_place(x, p, ranges, y)
    after_rates = _absorb_rates(x, p, rates, moved)
    starts_us = windows.starts_us
    ages = np.zeros(starts_us.shape[0])
    for w in range(ages.shape[0]):
        # 0 marks a window that has not begun; its age stays zero.
        if starts_us[w] != 0:
            ages[w] = (step.t_us - starts_us[w]) * 1e-6
    d, sums = respond_to_ranges(windows, ages, step.phi, after, ranges, step.dt_s)
    respond_to_rates(d, sums, after_rates, rates)
    offset, spread = learn_offsets(windows, prior, ranges, step.dt_s, numbers)
    now = RampWindows(starts_us, d, sums, offset, spread, windows.offsets, windows.spreads)
    return (x, p, d, sums, offset, spread), strongest_ramp(now, ages, step.inertial, numbers)
