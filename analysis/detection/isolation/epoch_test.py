"""One GNSS epoch against the filter: everything the detector decides there."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import Core
from analysis.detection.epoch_outcome import Outcome, imu_bad_until_us, shown
from analysis.detection.filter.alignment import find_attitude
from analysis.detection.filter.epoch_update import absorb, remember
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.inertial import X_CLOCK
from analysis.detection.filter.information import statistic
from analysis.detection.filter.measurement import Observed
from analysis.detection.filter.offsets import held, hold, learnt
from analysis.detection.filter.passing import let_pass
from analysis.detection.filter.propagation import advance, segment
from analysis.detection.isolation.assessment import CLOCK_LEAP_M, Sight, see
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.isolation.exclusion import exclude, outside, readmit
from analysis.detection.isolation.ramp_test import judge_slow, new_memory, ready
from analysis.detection.isolation.range_test import (
    Tested,
    blamed,
    free_clock,
    free_position,
    passed,
)
from analysis.detection.isolation.rate_test import check_rates, freed_by
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector


def judge_epoch(
    t_us: int, observed: Observed, run: ImuRun, core: Core, config: DetectorConfig
) -> Outcome:
    """Predict, test, isolate, update: the core after an epoch and what it said; `run` is what the
    IMU gave since the last."""
    held_m = held(core, observed.satellites, t_us, config)
    passed = let_pass(t_us, observed, held_m, run, core, config)
    return passed or _judged(t_us, observed, held_m, run, core, config)


def _judged(
    t_us: int,
    observed: Observed,
    held_m: Vector,
    run: ImuRun,
    core: Core,
    config: DetectorConfig,
) -> Outcome:
    """An epoch that may need a verdict, step by step."""
    before = core.motion
    assert before is not None
    part = segment(run, before, t_us)
    motion, phi = advance(before, part, t_us, config)
    seen, leapt, motion, core = _seen(t_us, observed, held_m, motion, core, config)
    needed = 3 if motion.inertial else 4 + max(seen.systems, 1)
    if len(seen.names) < needed:
        reason = f"{len(seen.names)} healthy satellites above the mask; {needed} are needed"
        core = hold(core, t_us, config)
        return Outcome(core._replace(motion=motion, memory=None), reason)
    rates = check_rates(motion, seen.used, seen.assessed, config)
    tested = _tested(core, motion, seen, rates.hypothesis, config)
    undisturbed = not leapt and not tested.freed and rates.hypothesis in ("none", "satellites")
    memory, slow = None, None
    if undisturbed and before.inertial == tested.motion.inertial:
        memory = ready(
            core.memory or new_memory(before.t_us),
            t_us,
            observed.satellites,
            seen.names,
            tested.part.variance,
            config,
        )
        dt_s = (t_us - before.t_us) * 1e-6
        moved, memory, found = remember(
            tested.motion, tested.part, rates.fit, memory, phi, dt_s, config
        )
        slow = judge_slow(memory, found, config)
    else:
        moved = absorb(tested.motion, tested.part, rates.fit)
        core = hold(core, t_us, config)
    wrong = slow.hypothesis if slow is not None else "none"
    imu_blamed = before.inertial and "imu" in (rates.hypothesis, tested.hypothesis, wrong)
    if imu_blamed and moved.inertial:
        moved = free_position(moved)
    left = outside(seen.others, seen.left, motion, moved)
    excluded = readmit(core.excluded, left, t_us, config)
    excluded = exclude(excluded, tuple(seen.names[i] for i in tested.left_out), t_us, t_us)
    core = core._replace(
        ranges_us=t_us,
        excluded=excluded,
        imu_bad_until_us=imu_bad_until_us(core, imu_blamed, t_us, config),
    )
    moved = find_attitude(core, moved, part, (t_us - before.t_us) * 1e-6, config)
    if memory is not None and moved.inertial and not before.inertial:
        memory = memory.without_accelerations()
    core = core._replace(motion=moved, memory=memory)
    core = _unknown(core, tested.hypothesis, t_us, config)
    silent = before.inertial and part.gap_s > config.gap_s
    assessed = seen.assessed
    return Outcome(
        core,
        names=seen.names,
        left_out=tested.left_out,
        others=left.names,
        residual_m=(*seen.used.v_m.tolist(), *left.v_m.tolist()),
        normalised=(*assessed.normalised.tolist(), *left.normalised.tolist()),
        statistic=tested.statistic,
        threshold=tested.threshold,
        probabilities=tested.probabilities,
        parity=assessed.parity,
        parity_dof=assessed.parity_dof,
        rate=rates.statistic,
        rate_threshold=rates.threshold,
        rate_dof=rates.dof,
        slow=slow,
        hypothesis=shown(core, tested.hypothesis, imu_blamed or silent, leapt),
        alarm=tested.alarm or imu_blamed or silent,
        imu_blamed=imu_blamed,
        was_inertial=before.inertial,
        gap_s=part.gap_s,
    )


def _tested(
    core: Core, motion: Motion, seen: Sight, by_rates: str, config: DetectorConfig
) -> Tested:
    """The ranges' test after what the rates have said of the prediction."""
    freed = freed_by(motion, by_rates)
    used, q = seen.used, seen.assessed.q
    if freed is not motion:
        q = statistic(freed.p, used.h, used.variance, used.v_m)
    threshold = chi_square(len(seen.names), config.p_false_alarm)
    if q <= threshold:
        return passed(freed, used, q, threshold)
    standing_m = learnt(core, seen.names)
    return blamed(freed, used, q, threshold, standing_m, config)


def _seen(
    t_us: int,
    observed: Observed,
    held_m: Vector,
    motion: Motion,
    core: Core,
    config: DetectorConfig,
) -> tuple[Sight, bool, Motion, Core]:
    """The epoch against the prediction, and whether the clock leapt; it is set where it did.

    Where others are trusted than at the last epoch, what was learnt of them is held.
    """
    names = observed.satellites
    trusted = np.ones(len(names), dtype=bool)
    if core.excluded:
        trusted = np.array([name not in core.excluded for name in names], dtype=bool)
    ionosphere = core.ionosphere
    seen = see(observed, trusted, held_m, motion, ionosphere, config)
    leap = _leap_m(seen) if seen.far else 0.0
    if leap:
        x = motion.x.copy()
        x[X_CLOCK] += leap
        motion = free_clock(motion._replace(x=x))
        seen = see(observed, trusted, held_m, motion, ionosphere, config)
    if core.memory is not None and core.memory.names != seen.names:
        core = hold(core, t_us, config)
        held_m = held(core, names, t_us, config)
        seen = see(observed, trusted, held_m, motion, ionosphere, config)
    return seen, leap != 0.0, motion, core


def _leap_m(seen: Sight) -> float:
    """How far the receiver set its clock; 0 if it did not."""
    innovations = sorted((*seen.used.v_m.tolist(), *seen.left.v_m.tolist()))
    middle: float = innovations[len(innovations) // 2]
    return middle if abs(middle) > CLOCK_LEAP_M else 0.0


def _unknown(core: Core, hypothesis: str, t_us: int, config: DetectorConfig) -> Core:
    """A filter that nothing fits for too long is started anew."""
    if hypothesis != "multiple-unknown":
        return core._replace(unknown_since_us=None) if core.unknown_since_us else core
    since = core.unknown_since_us or t_us
    if (t_us - since) * 1e-6 >= config.reset_s:
        return core._replace(motion=None, memory=None, unknown_since_us=None)
    return core._replace(unknown_since_us=since)
