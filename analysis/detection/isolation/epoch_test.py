"""One GNSS epoch against the filter: assess it, isolate where a test trips, commit the rest."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, EpochRecord
from analysis.detection.epoch_outcome import (
    EpochOutcome,
    next_imu_suspension_us,
    reported_hypothesis,
)
from analysis.detection.filter.alignment import align_attitude
from analysis.detection.filter.epoch_update import EpochStep, absorb_epoch, commit_epoch
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import X_CLOCK
from analysis.detection.filter.information import innovation_statistic, normal_equations
from analysis.detection.filter.lasting_errors import VarianceFactor
from analysis.detection.filter.measurement import EpochObservation
from analysis.detection.filter.offsets import freeze_offsets, frozen_offsets_m, learned_offsets_m
from analysis.detection.filter.propagation import ImuSegment, imu_segment, propagate_filter
from analysis.detection.isolation.all_satellites import (
    COASTING_REASON,
    FOLLOWED_REASON,
    JUMP_REASON,
    accumulated_jump_m,
    common_jump_m,
    follow_jump,
    next_distrust,
    ranges_beyond_imu,
    rates_beyond_imu,
)
from analysis.detection.isolation.assessment import (
    CLOCK_JUMP_M,
    LEAST_RATES,
    Sight,
    parity_test,
    rate_equations,
    see,
)
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.common_shift import (
    LEAST_LEVEL,
    CommonShift,
    reset_common_shift,
    shift_is_suspected,
    shift_statistic,
    update_common_shift,
)
from analysis.detection.isolation.constellations import SYSTEMS_CONTRADICT
from analysis.detection.isolation.exclusion import (
    ExcludedInnovations,
    add_exclusions,
    innovations_of_excluded,
    readmit_satellites,
)
from analysis.detection.isolation.imu_or_satellites import (
    Blame,
    Moment,
    accused,
    by_whom,
    coasts,
    led_off,
    led_slowly,
)
from analysis.detection.isolation.quiet_epoch import quiet_epoch
from analysis.detection.isolation.ramp_test import (
    RampBank,
    RampVerdict,
    evaluate_ramps,
    new_ramps,
    prepare_ramps,
)
from analysis.detection.isolation.range_test import (
    RangeVerdict,
    free_clock,
    free_position,
    isolate_ranges,
    pass_ranges,
)
from analysis.detection.isolation.rate_test import RateVerdict, free_by_rates, isolate_rates
from analysis.detection.protection_levels import PositionBounds, bound_position
from analysis.detection.receiver.carry_off_windows import CarryOff
from analysis.detection.receiver.receiver_or_imu import UNDECIDED
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector

RUNNING = 3  # epochs in which a rate alone is wrong before that is told
UNDISTURBED = ("none", "satellites")  # verdicts of the rates that leave the prediction sound


class Judged(NamedTuple):
    """An epoch after its tests: the core and the IMU's samples before it, the prediction, what was
    seen, whether the clock leapt, the verdicts of rates and ranges, how far (3,) the satellites
    leapt together, who is at fault where the IMU seems to be, how all satellites lie, and the
    statistic of the velocity that all rates show off the IMU's."""

    core: DetectorCore
    part: ImuSegment
    predicted: MotionEstimate
    sight: Sight
    leapt: bool
    rates: RateVerdict
    tested: RangeVerdict
    leap_m: Vector | None = None
    accused: str = "imu"
    carried: CarryOff | None = None
    shift: float = 0.0


def judge_epoch(
    t_us: int,
    observed: EpochObservation,
    run: ImuRun,
    core: DetectorCore,
    config: DetectorConfig,
    past: Sequence[EpochRecord] = (),
) -> EpochOutcome:
    """Predict, test, isolate, update: the core after an epoch and what it showed; `run` is what the
    IMU gave since the last, `past` are the epochs before."""
    before = core.motion
    assert before is not None
    # The fast way first: it returns None wherever there is anything to decide.
    quiet = quiet_epoch(t_us, observed, run, core, config)
    if quiet is not None:
        return quiet
    part = imu_segment(run, before, t_us)
    motion, phi = propagate_filter(before, part, t_us, config)
    sight, leapt, motion, core = _seen(t_us, observed, motion, core, config)
    # Without the IMU one more than the unknowns, three of position and a clock per system; with it
    # the prediction can be contradicted by three.
    needed = 3 if motion.inertial else 4 + max(sight.tests.systems, 1)
    if len(sight.names) < needed:
        reason = f"{len(sight.names)} healthy satellites above the mask; {needed} are needed"
        # Too few to test is too few to use: an untested fault would move the filter unseen.
        core = freeze_offsets(core, t_us, config)
        return EpochOutcome(core._replace(motion=motion, ramps=None), reason)
    rates = isolate_rates(motion, sight.used, sight.tests, config)
    rates = rates_beyond_imu(rates, core, motion, sight.used, (past[-1].run if past else None, run))
    tested = _tested(core, motion, sight, rates.hypothesis, config)
    tested = ranges_beyond_imu(tested, rates, core, motion, sight.used)
    since_s = (t_us - before.t_us) * 1e-6
    moment = Moment(motion, phi, since_s, sight.used, part)
    blame = Blame(rates, tested)
    if before.inertial and motion.inertial:
        blame = by_whom(core, past, moment, rates, tested, config)
    rates, tested = blame.rates, blame.tested
    leap = common_jump_m(tested, motion, sight.used, sight.tests, since_s, config.p_false_alarm)
    if leap is not None:
        tested = follow_jump(tested, motion, sight.used)
    judged = Judged(core, part, motion, sight, leapt, rates, tested, leap, *blame[2:])
    undisturbed = not leapt and not tested.prediction_freed and rates.hypothesis in UNDISTURBED
    # Ramp tests need one unbroken filter: what was freed or leapt has no response to follow.
    if undisturbed and before.inertial == tested.motion.inertial:
        outcome, judged = _by_windows(judged, before, moment, past, observed.satellites, config)
        if outcome is not None:
            return outcome
    # The windows end here; what they had learnt of offsets lives on, frozen.
    moved = absorb_epoch(judged.tested.motion, judged.tested.usable, rates.fit)
    # What is learnt while a system moves is the system's shift, and no offset of satellites.
    if not judged.tested.whole_system:
        judged = judged._replace(core=freeze_offsets(core, t_us, config))
    return _concluded(judged, before, moved, None, None, config)


def _by_windows(
    judged: Judged,
    before: MotionEstimate,
    moment: Moment,
    past: Sequence[EpochRecord],
    among: tuple[str, ...],
    config: DetectorConfig,
) -> tuple[EpochOutcome | None, Judged]:
    """What the tests with memory say of an epoch that passes, whose satellites are `among`; no
    outcome where its ranges are to be used otherwise, as is then judged."""
    core, tested, rates, t_us = judged.core, judged.tested, judged.rates, moment.motion.t_us
    names, variance = judged.sight.names, tested.usable.variance
    ramps = prepare_ramps(
        core.ramps or new_ramps(before.t_us), t_us, among, names, variance, config
    )
    step = EpochStep(moment.phi, moment.dt_s, t_us, tested.motion.inertial)
    moved, ramps, found = commit_epoch(tested.motion, tested.usable, rates.fit, ramps, step, config)
    slow, led = evaluate_ramps(ramps, found, config), None
    if before.inertial and slow.hypothesis == "imu":
        who, led = accused(past, moment, config)
        judged = judged._replace(accused=who)
    elif _passed(judged, before, slow, config):
        used, watched = judged.sight.used, core.watched
        equations = rate_equations(used.h, used.rate_variance, used.v_mps)
        judged = judged._replace(shift=shift_statistic(judged.predicted.p, equations))
        if shift_is_suspected(watched, judged.shift, t_us, config):
            led = led_slowly(past, moment, max(watched.level, LEAST_LEVEL), config)
    if led is not None:
        judged = judged._replace(**led_off(led, moment, rates, tested)._asdict())
        return _concluded(judged, before, judged.tested.motion, None, None, config), judged
    whole = _whole_system(judged, config) if slow.hypothesis == "satellites" else None
    if whole is None:
        return _concluded(judged, before, moved, ramps, slow, config), judged
    return None, judged._replace(tested=whole)


def _passed(
    judged: Judged, before: MotionEstimate, slow: RampVerdict | None, config: DetectorConfig
) -> bool:
    """Whether an epoch that the IMU has predicted passed every test, with rates to compare."""
    hypotheses = {judged.rates.hypothesis, judged.tested.hypothesis}
    quiet = slow is not None and slow.hypothesis == "none" and hypotheses == {"none"}
    known = config.doppler and judged.sight.tests.rates >= LEAST_RATES
    return quiet and known and before.inertial and judged.tested.motion.inertial


def _watched(
    judged: Judged,
    before: MotionEstimate,
    slow: RampVerdict | None,
    t_us: int,
    config: DetectorConfig,
) -> CommonShift:
    """What is known of the velocity that all rates show, after an epoch."""
    watched = judged.core.watched
    if not _passed(judged, before, slow, config):
        return reset_common_shift(watched, t_us)
    return update_common_shift(watched, judged.shift, t_us, config)


def _whole_system(judged: Judged, config: DetectorConfig) -> RangeVerdict | None:
    """The ranges' verdict where a ramp of one satellite is better explained by its whole system."""
    tested, sight = judged.tested, judged.sight
    standing_m = learned_offsets_m(judged.core, sight.names)
    q, threshold = tested.statistic, tested.threshold
    found = isolate_ranges(
        tested.motion, sight.used, q, threshold, standing_m, config, by_past=True
    )
    return found if found.whole_system else None


def _concluded(
    judged: Judged,
    before: MotionEstimate,
    moved: MotionEstimate,
    ramps: RampBank | None,
    slow: RampVerdict | None,
    config: DetectorConfig,
) -> EpochOutcome:
    """The verdicts together: who is excluded, whether the IMU is trusted, and the core after."""
    core, part, tested, t_us = judged.core, judged.part, judged.tested, moved.t_us
    verdicts = (judged.rates.hypothesis, tested.hypothesis, slow.hypothesis if slow else "none")
    # Without an inertial prediction its failure is a manoeuvre, not a fault of the IMU.
    imu_blamed = before.inertial and "imu" in verdicts
    # Who is known to have been led away, and is followed all the same, does not accuse the IMU.
    undecided = imu_blamed and (core.led or judged.accused == UNDECIDED)
    told_apart = imu_blamed and not undecided  # then it was the IMU before, too
    if imu_blamed and moved.inertial:
        moved = free_position(moved)
    sight = judged.sight
    outside = innovations_of_excluded(sight.excluded, sight.outside, judged.predicted, moved)
    excluded = readmit_satellites(core.excluded, outside, t_us, config)
    faulty = tuple(sight.names[i] for i in tested.faulty)
    excluded = add_exclusions(excluded, faulty, t_us, t_us, tested.whole_system)
    core = core._replace(
        ranges_us=t_us,
        excluded=excluded,
        imu_bad_until_us=next_imu_suspension_us(core, imu_blamed, t_us, config),
        unknown_since_us=_unknown_since_us(core, judged, t_us),
        distrusted=next_distrust(core, judged.rates, tested) if judged.leap_m is None else "",
        leapt_m=accumulated_jump_m(core.leapt_m, judged.leap_m),
        carried=judged.carried if tested.hypothesis == "gps" and judged.leap_m is None else None,
        unbounded=(core.unbounded or undecided) and not told_apart,
        rates_off=_rates_off(judged),
        watched=_watched(judged, before, slow, t_us, config),
    )
    moved = align_attitude(core, moved, part, (t_us - before.t_us) * 1e-6, config)
    # To a free filter an acceleration was the vehicle's own: it says nothing of the IMU.
    if ramps is not None and moved.inertial and not before.inertial:
        ramps = ramps.without_accelerations()
    core = core._replace(motion=moved, ramps=ramps)
    core = _given_up(core, t_us, config)
    # Silence of the IMU is shown like its fault: the prediction lacks it either way.
    silent = before.inertial and part.gap_s > config.gap_s
    shown_now = reported_hypothesis(core, tested.hypothesis, imu_blamed or silent, judged.leapt)
    alarm = tested.alarm or imu_blamed or silent
    misfit, found_bounds = _bounded(judged, moved, core, t_us - before.t_us, config)
    outcome = _measured(judged, outside, core._replace(misfit=misfit))
    return outcome._replace(
        bounds=found_bounds,
        unbounded=_unbounded(judged, core),
        slow=slow,
        hypothesis=shown_now,
        alarm=alarm,
        imu_blamed=imu_blamed,
        was_inertial=before.inertial,
        gap_s=part.gap_s,
    )


def _given_up(core: DetectorCore, t_us: int, config: DetectorConfig) -> DetectorCore:
    """The core without its filter where nothing has explained the ranges for too long."""
    unknown_us = core.unknown_since_us
    if unknown_us is None or (t_us - unknown_us) * 1e-6 < config.reset_s:
        return core
    # Whoever was distrusted is followed from here on, as nothing else tells a place.
    lying = core.unbounded or core.distrusted != ""
    return core._replace(
        motion=None,
        ramps=None,
        unknown_since_us=None,
        distrusted="",
        carried=None,
        unbounded=lying,
        led=core.led or core.distrusted != "",
    )


def _unbounded(judged: Judged, core: DetectorCore) -> str:
    """Why nothing bounds the position; empty where something does."""
    if judged.tested.whole_system and judged.tested.hypothesis == "multiple-unknown":
        return SYSTEMS_CONTRADICT
    if judged.carried is not None and coasts(judged.predicted, judged.sight.used):
        return COASTING_REASON
    if core.leapt_m is not None:
        return JUMP_REASON
    return FOLLOWED_REASON if core.unbounded else ""


def _rates_off(judged: Judged) -> dict[str, int]:
    """How many epochs running each satellite's Doppler rate alone was wrong."""
    names, before = judged.sight.names, judged.core.rates_off
    # One that the ranges blame too is shown as excluded.
    wrong = [names[i] for i in judged.rates.faulty if i not in judged.tested.faulty]
    return {name: before.get(name, 0) + 1 for name in wrong}


def _bounded(
    judged: Judged, moved: MotionEstimate, core: DetectorCore, since_us: int, config: DetectorConfig
) -> tuple[VarianceFactor, PositionBounds]:
    """How the ranges have fitted, and the bounds of the position after the epoch, by the satellites
    that were not found faulty."""
    sight, faulty = judged.sight, judged.tested.faulty
    tests, names, used = sight.tests, sight.names, sight.used
    parity, dof = tests.parity, tests.parity_dof
    if faulty:
        names = tuple(name for i, name in enumerate(names) if i not in faulty)
        keep = np.ones(len(sight.names), dtype=bool)
        keep[list(faulty)] = False
        # The verdict has chosen their rows already, with what was learnt of offsets subtracted.
        used = judged.tested.usable._replace(v_m=used.v_m[keep])
        parity, dof, _ = parity_test(normal_equations(used.h, used.variance, used.v_m))
    misfit = core.misfit.with_epoch(parity, dof, since_us * 1e-6)
    moved_m = moved.x[:3] - judged.predicted.x[:3]
    offset_m, share = frozen_offsets_m(judged.core, names, moved.t_us, config), config.sigma.slow**2
    return misfit, bound_position(used, moved_m, offset_m, moved.x[:3], misfit, share)


def _measured(judged: Judged, outside: ExcludedInnovations, core: DetectorCore) -> EpochOutcome:
    """The numbers of an epoch's tests."""
    sight, rates, tested = judged.sight, judged.rates, judged.tested
    tests = sight.tests
    residual_m, normalised = tests.residual_m.tolist(), tests.normalised.tolist()
    return EpochOutcome(
        core,
        names=sight.names,
        faulty=tested.faulty,
        excluded=outside.names,
        residual_m=residual_m + outside.v_m.tolist(),
        normalised=normalised + outside.normalised.tolist(),
        statistic=tested.statistic,
        threshold=tested.threshold,
        probabilities=tested.probabilities,
        parity=tests.parity,
        parity_dof=tests.parity_dof,
        rate=rates.statistic,
        rate_threshold=rates.threshold,
        rate_dof=rates.dof,
        rate_faulty=tuple(name for name, times in core.rates_off.items() if times >= RUNNING),
    )


def _tested(
    core: DetectorCore, motion: MotionEstimate, sight: Sight, by_rates: str, config: DetectorConfig
) -> RangeVerdict:
    """The ranges' test after the rates' verdict on the prediction."""
    freed = free_by_rates(motion, by_rates)
    used, q = sight.used, sight.tests.q
    if freed is not motion:
        # The statistic is computed again only where the covariance changed.
        q = innovation_statistic(freed.p, used.h, used.variance, used.v_m)
    threshold = chi_square_threshold(len(sight.names), config.p_false_alarm)
    if q <= threshold:
        return pass_ranges(freed, used, q, threshold)
    # Learnt offsets matter only when somebody is excluded and the geometry changes.
    standing_m = learned_offsets_m(core, sight.names)
    return isolate_ranges(freed, used, q, threshold, standing_m, config)


def _seen(
    t_us: int,
    observed: EpochObservation,
    motion: MotionEstimate,
    core: DetectorCore,
    config: DetectorConfig,
) -> tuple[Sight, bool, MotionEstimate, DetectorCore]:
    """The epoch against the prediction, and whether the clock leapt; it is set where it did.

    Where others are trusted than at the last epoch, what was learnt of them is frozen.
    """
    names = observed.satellites
    trusted = np.array([name not in core.excluded for name in names], dtype=bool)
    ionosphere, offset_m = core.ionosphere, frozen_offsets_m(core, names, t_us, config)
    sight = see(observed, trusted, offset_m, motion, ionosphere, config)
    # The median below is sorted for, so it is asked for only when most innovations are far.
    leap = _leap_m(sight) if sight.tests.far else 0.0
    if leap:
        x = motion.x.copy()
        x[X_CLOCK] += leap
        motion = free_clock(motion._replace(x=x))
        sight = see(observed, trusted, offset_m, motion, ionosphere, config)
    # Twice `see` at a change of satellites: innovations must be those of the new offsets.
    if core.ramps is not None and core.ramps.names != sight.names:
        core = freeze_offsets(core, t_us, config)
        offset_m = frozen_offsets_m(core, names, t_us, config)
        sight = see(observed, trusted, offset_m, motion, ionosphere, config)
    return sight, leap != 0.0, motion, core


def _leap_m(sight: Sight) -> float:
    """How far the receiver set its clock; 0 if it did not."""
    innovations = sorted((*sight.used.v_m.tolist(), *sight.outside.v_m.tolist()))
    # The median: a single faulty satellite must not set the clock.
    middle: float = innovations[len(innovations) // 2]
    return middle if abs(middle) > CLOCK_JUMP_M else 0.0


def _unknown_since_us(core: DetectorCore, judged: Judged, t_us: int) -> int | None:
    """Since when nothing of the epochs can be used."""
    unknown = judged.tested.hypothesis in ("multiple-unknown", "gps")
    if not unknown or judged.leap_m is not None:
        return None
    # The first epoch of the stretch counts.
    return core.unknown_since_us or t_us
