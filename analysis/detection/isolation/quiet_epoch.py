"""Predict, assess, and commit if nothing trips: a quiet epoch in one compiled call.

Nearly every epoch of a flight is quiet. The kernels are those of `epoch_test`, which begins anew
with an epoch that has anything to decide.
"""

from typing import Any, NamedTuple

import numpy as np

from analysis.detection.detection_config import (
    MOST_SATELLITES,
    DetectorConfig,
    NoiseDensities,
    RampNumbers,
    SigmaNumbers,
)
from analysis.detection.detector_state import NO_RATES_OFF, DetectorCore
from analysis.detection.epoch_outcome import (
    EpochOutcome,
    next_imu_suspension_us,
    reported_hypothesis,
)
from analysis.detection.filter.epoch_update import CommittedArrays, EpochStep, commit_kernel
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import propagate_freely, propagate_inertial
from analysis.detection.filter.lasting_errors import (
    LEAST_FACTOR,
    VarianceFactor,
    update_variance_factor,
)
from analysis.detection.filter.measurement import (
    EpochMeasurements,
    EpochObservation,
    Indices,
    Innovations,
)
from analysis.detection.filter.offsets import frozen_offsets_m
from analysis.detection.filter.propagation import segment_steps
from analysis.detection.isolation.assessment import (
    LEAST_RATES,
    Assessment,
    assess,
    rate_equations,
)
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.common_shift import (
    CommonShift,
    shift_is_suspected,
    shift_statistic,
)
from analysis.detection.isolation.common_shift import update_common_shift as watched_after
from analysis.detection.isolation.ramp_test import evaluate_ramps
from analysis.detection.isolation.ramp_windows import RampWindows, StrongestRamp
from analysis.detection.protection_levels import PositionBounds, bounds_kernel, level_factors
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

NOTHING_FOUND = 0.0, -1, -1, 0.0

# Named tuples go into the compiled call as plain ones and get their names inside it: numba looks up
# the class of each that crosses its boundary, either way, which takes a microsecond.
Fields = tuple[Any, ...]
# What stays of a quiet epoch's tests: q, q_rate, the velocity that the rates share, parity, rates
# and parity_dof.
Numbers = tuple[float, float, float, float, int, int]
Found = tuple[float, int, int, float]  # the fields of `StrongestRamp`


class Prior(NamedTuple):
    """The filter at the last epoch, and whether the IMU moves it."""

    t_us: int
    x: Vector
    p: Vector
    inertial: bool


class Limits(NamedTuple):
    """What an epoch is judged by: models of the sky and of noise, the thresholds (2, 65) of ranges
    and rates by degrees of freedom, in the order of `DetectorConfig.limits`; those of protection
    levels, and how the ranges have fitted."""

    ionosphere: Vector
    sigma: SigmaNumbers
    noise: NoiseDensities
    ramps: RampNumbers
    thresholds: Vector
    mask_rad: float
    gap_s: float
    doppler: bool
    level_factors: Vector
    misfit: VarianceFactor


def quiet_epoch(
    t_us: int, observed: EpochObservation, run: ImuRun, core: DetectorCore, config: DetectorConfig
) -> EpochOutcome | None:
    """The core after the epoch and what it showed; None where there is anything to decide."""
    motion, ramps = core.motion, core.ramps
    # Identity, not equality: the names are the same tuple while the view is the same.
    if motion is None or ramps is None or ramps.in_view is not observed.satellites:
        return None
    if _is_rare(core, motion, config) or len(ramps.names) > MOST_SATELLITES:
        return None
    ramps = ramps.renewed(t_us)
    quiet, gap_s, numbers, innovations, after, found, bounds = _quiet(
        tuple(observed.measured),
        ramps.places,
        frozen_offsets_m(core, observed.satellites, t_us, config),
        (motion.t_us, motion.x, motion.p, motion.inertial),
        tuple(run),
        t_us,
        tuple(ramps.windows),
        (core.ionosphere, *config.limits, level_factors(), *core.misfit),
    )
    slow = evaluate_ramps(ramps, StrongestRamp(*found), config) if quiet else None
    q, q_rate, shift, parity, rates, parity_dof = numbers
    watched = _watched(core.watched, motion, shift, t_us, config)
    if slow is None or slow.hypothesis != "none" or watched is None:
        return None
    x, p, d, sums, offset, spread = after
    total, dof, *lasting_m2, hpl_m, vpl_m = bounds.tolist()
    misfit = VarianceFactor(total, dof)
    windows = ramps.windows._replace(d=d, sums=sums, offset=offset, spread=spread)
    core = core._replace(
        motion=MotionEstimate(t_us, x, p, motion.inertial),
        ramps=ramps._replace(windows=windows),
        ranges_us=t_us,
        imu_bad_until_us=next_imu_suspension_us(core, False, t_us, config),
        unknown_since_us=None,
        misfit=misfit,
        rates_off=NO_RATES_OFF,
        watched=watched,
    )
    residual_m, normalised = innovations.tolist()
    tested = config.doppler and rates >= LEAST_RATES
    return EpochOutcome(
        core,
        names=ramps.names,
        residual_m=residual_m,
        normalised=normalised,
        statistic=q,
        threshold=chi_square_threshold(len(ramps.names), config.p_false_alarm),
        parity=parity,
        parity_dof=parity_dof,
        rate=q_rate if tested else None,
        rate_threshold=chi_square_threshold(rates, config.p_other) if tested else None,
        rate_dof=rates if tested else 0,
        slow=slow,
        hypothesis=reported_hypothesis(core, "none", False, False),
        was_inertial=motion.inertial,
        gap_s=gap_s,
        bounds=PositionBounds(misfit.factor, tuple(lasting_m2), hpl_m, vpl_m),
    )


def _watched(
    watched: CommonShift, motion: MotionEstimate, shift: float, t_us: int, config: DetectorConfig
) -> CommonShift | None:
    """What is known of the velocity that all rates show; None where it is to be asked about."""
    if not (motion.inertial and config.doppler):
        return watched
    if shift_is_suspected(watched, shift, t_us, config):
        return None
    return watched_after(watched, shift, t_us, config)


def _is_rare(core: DetectorCore, motion: MotionEstimate, config: DetectorConfig) -> bool:
    """Excluded satellites, a leap, an alignment under way and a lever arm need the long way."""
    if core.excluded or core.distrusted or core.leapt_m is not None or motion.alignment is not None:
        return True
    if core.unbounded:
        return True
    return motion.inertial and config.antenna is not None


@compiled
def _named(limits: Fields) -> Limits:
    """The limits with their names."""
    ionosphere, sigma, noise, ramps, thresholds, mask_rad, gap_s, doppler = limits[:8]
    factors, total, dof = limits[8:]
    return Limits(
        ionosphere,
        SigmaNumbers(*sigma),
        NoiseDensities(*noise),
        RampNumbers(*ramps),
        thresholds,
        mask_rad,
        gap_s,
        doppler,
        factors,
        VarianceFactor(total, dof),
    )


@compiled
def _quiet(
    measured_values: Fields,
    places: Indices,
    offset_m: Vector,
    prior_values: Fields,
    run_values: Fields,
    t_us: int,
    window_values: Fields,
    limit_values: Fields,
) -> tuple[bool, float, Numbers, Vector, CommittedArrays, Found, Vector]:
    """Whether the epoch is quiet, the longest silence of the IMU, the tests, the innovations (2, n)
    in m and normalised, what `commit_kernel` gives, and the fields of a `VarianceFactor` with those
    of the `PositionBounds` but the first (7,); `places` (n,) of the satellites that were used
    at the last epoch."""
    measured, prior, run = (
        EpochMeasurements(*measured_values),
        Prior(*prior_values),
        ImuRun(*run_values),
    )
    windows, limits = RampWindows(*window_values), _named(limit_values)
    samples, gap_s, heard = segment_steps(run.t_us, run.values, prior.t_us, t_us)
    dt_s = (t_us - prior.t_us) * 1e-6
    if prior.inertial:
        # An inertial epoch without samples is a gap, which is a verdict of its own.
        moved = samples.shape[0] > 0 and gap_s <= limits.gap_s
        x, p, phi = propagate_inertial(prior.x, prior.p, samples, limits.noise)
    else:
        moved = not heard  # an attitude might be found
        x, p, phi = propagate_freely(prior.x, prior.p, dt_s, limits.noise)
    # No satellite is excluded here, or the caller would not have come.
    trusted = np.ones(offset_m.shape[0], np.bool_)
    assessed = assess(
        measured, trusted, offset_m, x, p, limits.ionosphere, limits.sigma, limits.mask_rad
    )
    tests = assessed.statistics
    known = limits.doppler and tests.rates >= LEAST_RATES
    shift = shift_statistic(p, assessed.rates) if prior.inertial and known else 0.0
    numbers = tests.q, tests.q_rate, shift, tests.parity, tests.rates, tests.parity_dof
    innovations = np.empty((2, assessed.used))
    innovations[0], innovations[1] = tests.residual_m, tests.normalised
    quiet = moved and _is_quiet(assessed, places, prior.inertial, known, limits.thresholds)
    if not quiet:
        # The long way begins anew from the state before: nothing of this is used.
        nothing = (x, p, windows.d, windows.sums, windows.offset, windows.spread)
        return False, gap_s, numbers, innovations, nothing, NOTHING_FOUND, np.empty(0)
    rates = assessed.rates
    if not known:  # too few to be used untested
        every = assessed.every
        rates = rate_equations(every.h[:0], every.rate_variance[:0], every.v_mps[:0])
    step = EpochStep(phi, dt_s, t_us, prior.inertial)
    after, found = commit_kernel(
        x, p, assessed.ranges, assessed.y, rates, step, windows, limits.ramps
    )
    strongest = found.ramp, found.window, found.satellite, found.rival
    fit = _bounds_now(assessed, offset_m, x, after[0], dt_s, limits)
    return True, gap_s, numbers, innovations, after, strongest, fit


@compiled
def _bounds_now(
    assessed: Assessment, offset_m: Vector, x: Vector, after: Vector, dt_s: float, limits: Limits
) -> Vector:
    """How the ranges fit now, and the bounds of the position, as (7,); the state was x (21,) before
    the epoch and is `update_common_shift`."""
    count, every, tests = assessed.used, assessed.every, assessed.statistics
    used = Innovations(
        every.v_m[:count],
        every.v_mps[:count],
        every.variance[:count],
        every.rate_variance[:count],
        every.elevation_rad[:count],
        every.ionosphere_m[:count],
        every.h[:count],
    )
    frozen_m, out = np.empty(count), np.empty(7)
    for i in range(count):
        frozen_m[i] = offset_m[assessed.order[i]]
    before = limits.misfit
    total, dof = update_variance_factor(
        before.total, before.dof, tests.parity, tests.parity_dof, dt_s
    )
    out[0], out[1] = total, dof
    factor = max(total / dof, LEAST_FACTOR)
    out[2:] = bounds_kernel(
        used,
        after[:3] - x[:3],
        frozen_m,
        after[:3],
        factor,
        limits.ramps.offset_share,
        limits.level_factors,
    )
    return out


@compiled
def _is_quiet(
    assessed: Assessment, places: Indices, inertial: bool, tested: bool, thresholds: Vector
) -> bool:
    """Whether the same satellites are above the mask as at the last epoch, are enough, and pass."""
    count, tests = assessed.used, assessed.statistics
    # The same minimum as in `epoch_test`.
    if count != places.shape[0] or tests.far or count < (3 if inertial else 4 + tests.systems):
        return False
    for i in range(count):
        # Others in view than before: the windows must be arranged anew.
        if assessed.order[i] != places[i]:
            return False
    rates_pass = not tested or bool(tests.q_rate <= thresholds[1, tests.rates])
    return rates_pass and bool(tests.q <= thresholds[0, count])
