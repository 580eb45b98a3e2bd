"""The decision on a receiver's fix without raw ranges, by tests of its position and velocity.

Three position components have no redundancy, so the fault is isolated by the velocity and by
whether the receiver is consistent with itself (docs/fdi.md, "Without raw ranges").
"""

from dataclasses import replace

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, DetectorState
from analysis.detection.filter.alignment import align_attitude
from analysis.detection.filter.covariance_release import free_position, release
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import R
from analysis.detection.filter.propagation import (
    Prediction,
    predict,
    split_pending,
    update_interval_s,
)
from analysis.detection.isolation.exclusion import add_exclusions
from analysis.detection.receiver.carry_off_test import (
    detect_carry_off,
    estimate_carry_off,
    is_still_carried_off,
)
from analysis.detection.receiver.carry_off_windows import SETTLED_US, remove_carry_off
from analysis.detection.receiver.drift_return import follow_drift, has_returned
from analysis.detection.receiver.fix_latency import (
    append_interval,
    compensate_latency,
    initial_latency,
    mean_acceleration,
    update_latency,
)
from analysis.detection.receiver.heading import limit_heading_update
from analysis.detection.receiver.imu_scatter import update_scatter
from analysis.detection.receiver.position_test import (
    VELOCITY_SIGMA_MPS,
    AssessedFix,
    FixMeasurement,
    fix_measurement,
    run_fix_tests,
    start_at_fix,
    update_with_fix,
)
from analysis.detection.receiver.receiver_or_imu import (
    UNDECIDED,
    isolate_acceleration_fault,
    isolate_receiver_or_imu,
    new_last_fix,
)
from analysis.detection.receiver.receiver_state import LastFix
from analysis.detection.stages.decision_record import (
    RECEIVER,
    build_fix_decision,
    fix_sensor_decisions,
    untestable_decision,
)
from analysis.detection.stages.epoch_outcome import update_suspension
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.streams.fix_repeats import fix_values
from analysis.results import Result
from analysis.samples.sample import GpsFix, Vector

RECEIVER_VELOCITY = "gps-velocity"  # the velocity's name among the excluded
IMU_IN_DOUBT = ("imu", UNDECIDED)  # hypotheses after which the IMU is not used for a while
PAUSED_S = 1.5  # without a fix: more than an interval at 1 Hz
LOST_M = 300.0  # sigma above which the filter starts again


def step_position(
    fix: GpsFix, state: DetectorState, config: DetectorConfig
) -> tuple[list[Result], DetectorState]:
    """The decision on one fix and the next state."""
    core, pending, mag_b = state
    receiver = core.receiver
    # The same receiver may come in several messages, which are no second witness: one of them is
    # followed, HIL_GPS wherever it is.
    if receiver.source not in (None, fix.source) and fix.source != "HIL_GPS":
        return [], state
    latency = receiver.latency if fix.source == receiver.source else initial_latency(fix.source)
    repeats = receiver.repeats.updated(fix.t_us, fix_values(fix))
    receiver = receiver._replace(source=fix.source, latency=latency, repeats=repeats)
    core = core._replace(receiver=receiver, imu=core.imu._replace(mag_b=mag_b))
    measurement, reason = fix_measurement(fix)
    motion = core.motion
    if measurement is None:
        return [untestable_decision(fix.t_us, reason)], DetectorState(core, pending, mag_b)
    if motion is not None:
        since_s = (fix.t_us - motion.t_us) * 1e-6
        if -config.reset_s < since_s <= 0.0:
            reason = f"time went back by {-since_s:.3f} s"
            return [untestable_decision(fix.t_us, reason)], DetectorState(core, pending, mag_b)
        if not 0.0 < since_s <= config.reset_s or np.sqrt(motion.p[0, 0]) > LOST_M:
            motion = None
    run, pending = split_pending(pending, fix.t_us)
    if motion is None:
        core = _restart(core, start_at_fix(fix.t_us, measurement))
        decision = build_fix_decision(fix, core, None, "none", False, "start")
        return [decision], DetectorState(core, pending, mag_b)
    interval_s = update_interval_s(core.imu.interval_s, run)
    core = core._replace(imu=core.imu._replace(interval_s=interval_s))
    results, core = _run_stages(
        fix, measurement, predict(motion, run, fix.t_us, config), core, config
    )
    return results, DetectorState(core, pending, mag_b)


def _run_stages(
    fix: GpsFix,
    measurement: FixMeasurement,
    prediction: Prediction,
    core: DetectorCore,
    config: DetectorConfig,
) -> tuple[list[Result], DetectorCore]:
    """The decisions on a predicted fix, and the core after it."""
    motion, receiver = prediction.motion, core.receiver
    acceleration = mean_acceleration(prediction.before, motion, measurement.axes)
    latency = append_interval(receiver.latency, prediction.dt_s, acceleration)
    measurement = compensate_latency(measurement, motion, latency)
    tests = run_fix_tests(measurement, motion, config)
    assessed = AssessedFix(measurement, prediction, *tests)
    drift = follow_drift(receiver.drift, receiver.last_fix, measurement, motion.t_us)
    jumps = not (assessed.position.passes or core.trust.excluded) and assessed.velocity is not None
    if jumps and has_returned(receiver.drift, drift, measurement, motion.t_us):
        # The position is then as uncertain as the jump is long; the rest is kept.
        jump_m = assessed.position.v
        assessed = assessed.with_motion(release(motion, (R, 3, float(jump_m @ jump_m))), config)
    scatter = update_scatter(receiver.scatter, prediction.segment, motion.t_us)
    receiver = receiver._replace(latency=latency, drift=drift, scatter=scatter)
    core = core._replace(receiver=receiver)
    hypothesis, alarm = _isolate(core, assessed, config)
    trusted = not core.trust.excluded
    receiver, found, wrong_mps2 = detect_carry_off(receiver, assessed, trusted, config)
    if found is not None:
        core = core._replace(trust=core.trust._replace(carry_off=found.carried))
        assessed = assessed.with_motion(remove_carry_off(assessed.motion, found), config)
        hypothesis, alarm = "gps", True
    elif wrong_mps2 is not None:
        alarm = True
        hypothesis = isolate_acceleration_fault(receiver.last_fix, wrong_mps2, assessed)
    if hypothesis == "none" and assessed.velocity is not None:
        latency = update_latency(receiver.latency, assessed.velocity, assessed.motion.p)
        receiver = receiver._replace(latency=latency)
    core = _with_hysteresis(core._replace(receiver=receiver), hypothesis, assessed, config)
    moved = _update_filter(core, hypothesis, assessed, acceleration, config)
    moved = align_attitude(core.imu, moved, prediction.segment, prediction.dt_s, config)
    last = new_last_fix(receiver.last_fix, assessed, moved)
    core = core._replace(motion=moved, receiver=core.receiver._replace(last_fix=last))
    shown = _reported_hypothesis(core, hypothesis)
    mode = "position" if moved.inertial else "position-free"
    results: list[Result] = [build_fix_decision(fix, core, assessed.position, shown, alarm, mode)]
    # Everybody paused where there was no fix either.
    gap_s, dt_s = prediction.segment.gap_s, prediction.dt_s
    paused = dt_s > PAUSED_S and gap_s > 0.8 * dt_s
    by_imu = assessed.motion.inertial or prediction.before.inertial
    gap_s = gap_s if by_imu and not paused else 0.0
    results += fix_sensor_decisions(fix, core, assessed, gap_s, hypothesis, config)
    return results, core


def _restart(core: DetectorCore, motion: MotionEstimate) -> DetectorCore:
    """A filter that begins, and nothing of the past."""
    trust = core.trust._replace(excluded={}, unbounded=False, carry_off=None)
    receiver = core.receiver._replace(last_fix=None, windows=None)
    return core._replace(motion=motion, trust=trust, receiver=receiver)


def _reported_hypothesis(core: DetectorCore, hypothesis: str) -> str:
    """The hypothesis that the decision reports while a sensor is excluded."""
    if hypothesis != "none":
        return hypothesis
    if RECEIVER in core.trust.excluded:
        return "gps"
    if core.imu.suspended_until_us is not None:
        return UNDECIDED if core.trust.unbounded else "imu"
    return "none"


def _isolate(core: DetectorCore, fix: AssessedFix, config: DetectorConfig) -> tuple[str, bool]:
    """The faulty source of a failed test, and whether to raise an alarm."""
    motion, position, velocity = fix.motion, fix.position, fix.velocity
    # A fix that is only repeated measures nothing, however well it fits.
    if core.receiver.repeats.frozen:
        return "gps", True
    if fix.passes:
        return "none", False
    last = core.receiver.last_fix
    agrees = _self_consistent(last, fix, config)
    if not motion.inertial:  # nothing but steady motion predicts: a jump of position it is, or none
        return ("none", False) if agrees else ("gps", True)
    if velocity is None or velocity.passes or RECEIVER in core.trust.excluded:
        return "gps", True
    if agrees:
        faulty = isolate_receiver_or_imu(last, fix, config)
        shaken = motion.t_us - core.receiver.scatter.shaken_us < SETTLED_US
        return (UNDECIDED if shaken and faulty == "gps" else faulty), True
    return ("gps", True) if position.passes else ("multiple-unknown", True)


def _self_consistent(last: LastFix | None, fix: AssessedFix, config: DetectorConfig) -> bool:
    """Whether the receiver's position moved by its velocities since the last fix.

    They are the velocities at both ends; when the speed changed in between is unknown (at an impact
    it changes at once). So either velocity, or any between, may have moved the position.
    """
    measurement = fix.measurement
    if last is None or measurement.v_ned_mps is None:
        return True
    dt_s = (fix.motion.t_us - last.t_us) * 1e-6
    known = np.isfinite(measurement.v_ned_mps)
    # An unknown earlier velocity counts as unchanged.
    earlier = np.where(np.isfinite(last.v_ned_mps), last.v_ned_mps, measurement.v_ned_mps)
    changed = (measurement.v_ned_mps - earlier)[known]
    moved = measurement.axes @ (measurement.r_ecef_m - last.r_ecef_m)
    difference = moved[known] - (measurement.v_ned_mps[known] - changed / 2) * dt_s
    between_m = float(np.linalg.norm(changed)) * dt_s / 2
    unexplained_m = max(float(np.linalg.norm(difference)) - between_m, 0.0)
    variance = 0.5**2 + (VELOCITY_SIGMA_MPS[0] ** 2 + config.noise.motion_mps2**2 * dt_s) * dt_s**2
    q = unexplained_m**2 / variance
    return bool(q <= chi_square_threshold(int(known.sum()), config.p_other))


def _with_hysteresis(
    core: DetectorCore, hypothesis: str, fix: AssessedFix, config: DetectorConfig
) -> DetectorCore:
    """The core with the receiver excluded or readmitted, or with the IMU suspended."""
    t_us, trust = fix.motion.t_us, core.trust
    if hypothesis in IMU_IN_DOUBT:
        trust = trust._replace(unbounded=trust.unbounded or hypothesis == UNDECIDED)
        imu = update_suspension(core.imu, True, t_us, config)
        receiver = core.receiver._replace(windows=None)
        return core._replace(imu=imu, trust=trust, receiver=receiver)
    core = core._replace(imu=update_suspension(core.imu, False, t_us, config))
    if hypothesis in ("gps", "multiple-unknown"):
        carry_off = trust.carry_off
        if carry_off is None:
            carry_off = estimate_carry_off(core.receiver.last_fix, fix)
        # A receiver that is carried off slowly, or repeats its fix, fits at first.
        position_alone = carry_off is None and not core.receiver.repeats.frozen
        names = (RECEIVER,) if position_alone else (RECEIVER, RECEIVER_VELOCITY)
        excluded = add_exclusions(trust.excluded, names, t_us, t_us)
        again = replace(excluded[RECEIVER], healthy_since_us=None)
        trust = trust._replace(
            excluded={**excluded, RECEIVER: again}, carry_off=carry_off, unbounded=False
        )
        return core._replace(trust=trust)
    entry = trust.excluded.get(RECEIVER)
    if entry is None or not fix.passes:
        return core
    since_us = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
    if is_still_carried_off(trust.carry_off, fix):
        entry = replace(entry, healthy_since_us=None)
    elif (t_us - since_us) * 1e-6 >= config.readmit_s:
        return core._replace(trust=trust._replace(excluded={}, carry_off=None))
    else:
        entry = replace(entry, healthy_since_us=since_us)
    return core._replace(trust=trust._replace(excluded={**trust.excluded, RECEIVER: entry}))


def _update_filter(
    core: DetectorCore,
    hypothesis: str,
    fix: AssessedFix,
    acceleration_mps2: Vector,
    config: DetectorConfig,
) -> MotionEstimate:
    """The filter after an update with the trusted parts of the fix."""
    if hypothesis in IMU_IN_DOUBT or (hypothesis == "none" and not fix.position.passes):
        fix = fix.with_motion(free_position(fix.motion), config)
    motion = before = fix.motion
    if RECEIVER not in core.trust.excluded and fix.position.passes:
        motion = update_with_fix(motion, fix.position)
    velocity = fix.velocity
    if velocity is not None and velocity.passes and RECEIVER_VELOCITY not in core.trust.excluded:
        # Predicted again, as the position has just changed the filter's velocity, too.
        motion = update_with_fix(motion, fix.with_motion(motion, config).velocity or velocity)
    return limit_heading_update(before, motion, acceleration_mps2, fix.measurement.axes)
