"""Predict, assess, and commit if nothing trips: a quiet epoch in one compiled call.

Nearly every epoch of a flight is quiet. The kernels are those of `epoch_test`, which begins anew
with an epoch that has anything to decide.
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import (
    MOST,
    DetectorConfig,
    NoiseDensities,
    RampNumbers,
    SigmaNumbers,
)
from analysis.detection.detector_state import Core
from analysis.detection.filter.epoch_update import Filtered, Rates, Step, commit_to
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.inertial import propagate_freely, propagate_inertial
from analysis.detection.filter.measurement import NO_ROWS, Indices, Measured, Modelled, Observed
from analysis.detection.filter.offsets import frozen_m
from analysis.detection.filter.propagation import NO_STEPS, Segment, steps
from analysis.detection.isolation.assessment import Assessment, Sight, Statistics, assess
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.isolation.ramp_test import RampBank
from analysis.detection.isolation.ramp_windows import Strongest, Windows
from analysis.detection.isolation.range_test import Tested, passed
from analysis.detection.isolation.rate_test import MIN_RATES, NO_RATES, RatesTested
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled


class Judged(NamedTuple):
    """An epoch after its tests: the core and the IMU's samples before it, the prediction, what was
    seen, whether the clock leapt, and the verdicts of rates and ranges."""

    core: Core
    part: Segment
    predicted: Motion
    sight: Sight
    leapt: bool
    rates: RatesTested
    tested: Tested


class Prior(NamedTuple):
    """The filter at the last epoch, and whether the IMU moves it."""

    t_us: int
    x: Vector
    p: Vector
    inertial: bool


class Limits(NamedTuple):
    """What an epoch is held against: models of the sky and of noise, and the thresholds (2, 65) of
    ranges and rates by degrees of freedom."""

    ionosphere: Vector
    sigma: SigmaNumbers
    noise: NoiseDensities
    ramps: RampNumbers
    thresholds: Vector
    mask_rad: float
    gap_s: float
    doppler: bool


Quiet = tuple[Judged, Motion, RampBank, Strongest]


def quiet_epoch(
    t_us: int, observed: Observed, run: ImuRun, core: Core, config: DetectorConfig
) -> Quiet | None:
    """The epoch with filter and ramp tests after it; None where there is anything to decide."""
    motion, ramps = core.motion, core.ramps
    if motion is None or ramps is None or ramps.among is not observed.satellites:
        return None
    if core.excluded or len(ramps.names) > MOST or motion.alignment is not None:
        return None
    if motion.inertial and config.antenna is not None:
        return None
    ramps = ramps.renewed(t_us)
    quiet, gap_s, tests, after, found = _quiet(
        observed.measured,
        ramps.places,
        frozen_m(core, observed.satellites, t_us, config),
        Prior(motion.t_us, motion.x, motion.p, motion.inertial),
        run,
        t_us,
        ramps.windows,
        _limits(core, config),
    )
    if not quiet:
        return None
    x, p, d, sums, offset, spread = after
    windows = ramps.windows._replace(d=d, sums=sums, offset=offset, spread=spread)
    moved = Motion(t_us, x, p, motion.inertial)
    # the filter has used the rows within the call: none are handed on, arrays cost time
    sight = Sight(ramps.names, NO_ROWS, (), NO_ROWS, tests)
    threshold = chi_square(len(ramps.names), config.p_false_alarm)
    tested = passed(moved, NO_ROWS, tests.q, threshold)
    rates = RatesTested(None, None, 0, "none", NO_RATES)
    if config.doppler and tests.rates >= MIN_RATES:
        limit = chi_square(tests.rates, config.p_other)
        rates = RatesTested(tests.q_rate, limit, tests.rates, "none", NO_RATES)
    judged = Judged(core, Segment(NO_STEPS, gap_s, False), moved, sight, False, rates, tested)
    return judged, moved, ramps._replace(windows=windows), found


def _limits(core: Core, config: DetectorConfig) -> Limits:
    return Limits(
        core.ionosphere,
        config.sigma.numbers,
        config.noise.densities,
        config.ramp_numbers,
        config.thresholds,
        config.mask_rad,
        config.gap_s,
        config.doppler,
    )


@compiled
def _quiet(
    measured: Measured,
    places: Indices,
    offset_m: Vector,
    prior: Prior,
    run: ImuRun,
    t_us: int,
    windows: Windows,
    limits: Limits,
) -> tuple[bool, float, Statistics, Filtered, Strongest]:
    """Whether the epoch is quiet, the longest silence of the IMU, the tests, and what `commit_to`
    gives; `places` (n,) of the satellites that were used at the last epoch."""
    samples, gap_s, heard = steps(run.t_us, run.values, prior.t_us, t_us)
    dt_s = (t_us - prior.t_us) * 1e-6
    if prior.inertial:
        moved = samples.shape[0] > 0 and gap_s <= limits.gap_s
        x, p, phi = propagate_inertial(prior.x, prior.p, samples, limits.noise)
    else:
        moved = not heard  # an attitude might be found
        x, p, phi = propagate_freely(prior.x, prior.p, dt_s, limits.noise)
    trusted = np.ones(offset_m.shape[0], np.bool_)
    assessed = assess(
        measured, trusted, offset_m, x, p, limits.ionosphere, limits.sigma, limits.mask_rad
    )
    tests = assessed.statistics
    tested = limits.doppler and tests.rates >= MIN_RATES
    quiet = moved and _is_quiet(assessed, places, prior.inertial, tested, limits.thresholds)
    if not quiet:
        nothing = (x, p, windows.d, windows.sums, windows.offset, windows.spread)
        return False, gap_s, tests, nothing, Strongest(0.0, -1, -1, 0.0)
    count, every = assessed.used, assessed.every
    h, v, variance = every.h[:count], every.v_m[:count], every.variance[:count]
    rate_variance, known = every.rate_variance[:count], count if tested else 0
    used = Modelled(v, every.v_mps[:count], variance, rate_variance, every.elevation_rad[:count], h)
    rates = Rates(every.v_mps[:known], every.rate_variance[:known], every.h[:known])
    step = Step(phi, dt_s, t_us, prior.inertial)
    after, found = commit_to(x, p, used, rates, step, windows, limits.ramps)
    return True, gap_s, tests, after, found


@compiled
def _is_quiet(
    assessed: Assessment, places: Indices, inertial: bool, tested: bool, thresholds: Vector
) -> bool:
    """Whether the same satellites are above the mask as at the last epoch, are enough, and pass."""
    count, tests = assessed.used, assessed.statistics
    if count != places.shape[0] or tests.far or count < (3 if inertial else 4 + tests.systems):
        return False
    for i in range(count):
        if assessed.order[i] != places[i]:
            return False
    rates_pass = not tested or bool(tests.q_rate <= thresholds[1, tests.rates])
    return rates_pass and bool(tests.q <= thresholds[0, count])
