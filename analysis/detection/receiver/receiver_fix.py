"""Without raw ranges: the same tests on a receiver's own position and velocity.

Three position components have no redundancy among themselves, so who lies is told by the velocity
and by whether the receiver agrees with itself: a position that leaves while the velocity still
fits the IMU is the receiver's fault; a velocity that leaves while the receiver's positions move
with it is the receiver's or the IMU's, see `receiver_or_imu`. Where that cannot be told the filter
follows the receiver, and its position is declared unbounded.
"""

from dataclasses import replace

import numpy as np

from analysis.detection.decision_record import untestable_decision
from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import RECEIVER, DetectorCore, DetectorState
from analysis.detection.filter.alignment import align_attitude
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import (
    ImuSegment,
    imu_segment,
    propagate_filter,
    split_pending,
    update_interval_s,
)
from analysis.detection.fix_record import build_fix_decision, fix_sensor_decisions
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.exclusion import add_exclusions
from analysis.detection.isolation.range_test import free_position
from analysis.detection.receiver.carry_off_test import (
    Tests,
    detect_carry_off,
    estimate_carry_off,
    is_still_carried_off,
)
from analysis.detection.receiver.carry_off_windows import remove_carry_off
from analysis.detection.receiver.fix_latency import (
    append_interval,
    compensate_latency,
    initial_latency,
    mean_acceleration,
    update_latency,
)
from analysis.detection.receiver.frozen_fix import fix_values
from analysis.detection.receiver.heading import limit_heading_update
from analysis.detection.receiver.position_test import (
    VELOCITY_SIGMA_MPS,
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
from analysis.results import Result
from analysis.samples.sample import GpsFix, Vector

RECEIVER_VELOCITY = "gps-velocity"  # among what is excluded: beside the position, the velocity
IMU_IN_DOUBT = (
    "imu",
    UNDECIDED,
)  # hypotheses after which the filter does not trust the IMU for a while
PAUSED_S = 1.5  # without a fix
LOST_M = 300.0  # a filter as unsure as this is started anew


def step_position(
    fix: GpsFix, state: DetectorState, config: DetectorConfig
) -> tuple[list[Result], DetectorState]:
    """The decision on one fix and the next state."""
    core, pending, mag_b = state
    # The same receiver may come in several messages, which are no second witness: one of them is
    # followed, HIL_GPS wherever it is.
    if core.gps_source not in (None, fix.source) and fix.source != "HIL_GPS":
        return [], state
    latency = core.latency if fix.source == core.gps_source else initial_latency(fix.source)
    core = core._replace(gps_source=fix.source, latency=latency, mag_b=mag_b)
    core = core._replace(repeats=core.repeats.updated(fix.t_us, fix_values(fix)))
    measured, reason = fix_measurement(fix)
    motion = core.motion
    if measured is None:
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
        core = _restart(core, start_at_fix(fix.t_us, measured))
        decision = build_fix_decision(fix, core, None, None, "none", False, "start")
        return [decision], DetectorState(core, pending, mag_b)
    core = core._replace(imu_interval_s=update_interval_s(core.imu_interval_s, run))
    part = imu_segment(run, motion, fix.t_us)
    predicted, phi = propagate_filter(motion, part, fix.t_us, config)
    acceleration = mean_acceleration(motion, predicted, measured.axes)
    dt_s = (fix.t_us - motion.t_us) * 1e-6
    core = core._replace(latency=append_interval(core.latency, dt_s, acceleration))
    measured = compensate_latency(measured, predicted, core.latency)
    tests = run_fix_tests(measured, predicted, config)
    hypothesis, alarm = _isolate(core, measured, predicted, part, tests, config)
    core, found, wrong_mps2 = detect_carry_off(
        core, (predicted, phi), part, measured, tests, config
    )
    if found is not None:
        predicted, hypothesis, alarm = remove_carry_off(predicted, found), "gps", True
        tests = run_fix_tests(measured, predicted, config)
    elif wrong_mps2 is not None:
        alarm = True
        hypothesis = isolate_acceleration_fault(
            core.last_fix, wrong_mps2, measured, predicted, part
        )
    if hypothesis == "none" and tests[1] is not None:
        core = core._replace(latency=update_latency(core.latency, tests[1], predicted.p))
    core = _with_hysteresis(core, hypothesis, measured, tests, predicted, config)
    moved = _update_filter(predicted, core, hypothesis, measured, tests, acceleration, config)
    moved = align_attitude(core, moved, part, dt_s, config)
    core = core._replace(motion=moved, last_fix=new_last_fix(core.last_fix, measured, part, moved))
    shown = _reported_hypothesis(core, hypothesis)
    mode = "position" if moved.inertial else "position-free"
    results: list[Result] = [build_fix_decision(fix, core, *tests, shown, alarm, mode)]
    # Everybody paused where there was no fix either.
    paused = dt_s > PAUSED_S and part.gap_s > 0.8 * dt_s
    gap = part.gap_s if (predicted.inertial or motion.inertial) and not paused else 0.0
    results += fix_sensor_decisions(fix, core, *tests, gap, hypothesis, config)
    return results, DetectorState(core, pending, mag_b)


def _restart(core: DetectorCore, motion: MotionEstimate) -> DetectorCore:
    """A filter that begins, and nothing of the past."""
    return core._replace(
        motion=motion, excluded={}, last_fix=None, unbounded=False, carry=None, carried=None
    )


def _reported_hypothesis(core: DetectorCore, hypothesis: str) -> str:
    """What the decision says while somebody is still left out."""
    if hypothesis != "none":
        return hypothesis
    if RECEIVER in core.excluded:
        return "gps"
    if core.imu_bad_until_us is not None:
        return UNDECIDED if core.unbounded else "imu"
    return "none"


def _isolate(
    core: DetectorCore,
    measured: FixMeasurement,
    motion: MotionEstimate,
    part: ImuSegment,
    tests: Tests,
    config: DetectorConfig,
) -> tuple[str, bool]:
    """Whose fault a failed test is, and whether it is an alarm; `part` is the IMU since the last
    fix, which moved the filter to `motion`."""
    position, velocity = tests
    # A fix that is only repeated measures nothing, however well it fits.
    if core.repeats.frozen:
        return "gps", True
    if position.passes and (velocity is None or velocity.passes):
        return "none", False
    agrees = _self_consistent(core, measured, motion.t_us, config)
    if not motion.inertial:  # nothing but steady motion predicts: a jump of position it is, or none
        return ("none", False) if agrees else ("gps", True)
    if velocity is None or velocity.passes or RECEIVER in core.excluded:
        return "gps", True
    if agrees:
        return isolate_receiver_or_imu(
            core.last_fix, measured, motion, velocity, part, config
        ), True
    return ("gps", True) if position.passes else ("multiple-unknown", True)


def _self_consistent(
    core: DetectorCore, measured: FixMeasurement, t_us: int, config: DetectorConfig
) -> bool:
    """Whether the receiver's position moved as its velocities say since the last fix.

    They say how fast it was at both ends. When in between the speed changed is not known: at an
    impact with the ground at once. So it may have moved by either velocity, or anything between.
    """
    last = core.last_fix
    if last is None or measured.v_ned_mps is None:
        return True
    dt_s = (t_us - last.t_us) * 1e-6
    known = np.isfinite(measured.v_ned_mps)
    # Without an earlier velocity it is taken for unchanged.
    earlier = np.where(np.isfinite(last.v_ned_mps), last.v_ned_mps, measured.v_ned_mps)
    changed = (measured.v_ned_mps - earlier)[known]
    moved = measured.axes @ (measured.r_ecef_m - last.r_ecef_m)
    difference = moved[known] - (measured.v_ned_mps[known] - changed / 2) * dt_s
    between_m = float(np.linalg.norm(changed)) * dt_s / 2
    unexplained_m = max(float(np.linalg.norm(difference)) - between_m, 0.0)
    variance = 0.5**2 + (VELOCITY_SIGMA_MPS[0] ** 2 + config.noise.motion_mps2**2 * dt_s) * dt_s**2
    q = unexplained_m**2 / variance
    return bool(q <= chi_square_threshold(int(known.sum()), config.p_other))


def _with_hysteresis(
    core: DetectorCore,
    hypothesis: str,
    measured: FixMeasurement,
    tests: Tests,
    motion: MotionEstimate,
    config: DetectorConfig,
) -> DetectorCore:
    """The receiver left out or back in; the IMU left out for a while."""
    (position, velocity), t_us = tests, motion.t_us
    if hypothesis in IMU_IN_DOUBT:
        until_us = t_us + round(config.imu_hold_s * 1e6)
        unbounded = core.unbounded or hypothesis == UNDECIDED
        return core._replace(imu_bad_until_us=until_us, unbounded=unbounded, carry=None)
    if core.imu_bad_until_us is not None and t_us >= core.imu_bad_until_us:
        core = core._replace(imu_bad_until_us=None)
    if hypothesis in ("gps", "multiple-unknown"):
        core = estimate_carry_off(core, measured, velocity)
        # One that is carried off slowly, or stands, fits at first.
        position_alone = core.carried is None and not core.repeats.frozen
        names = (RECEIVER,) if position_alone else (RECEIVER, RECEIVER_VELOCITY)
        excluded = add_exclusions(core.excluded, names, t_us, t_us)
        again = replace(excluded[RECEIVER], healthy_since_us=None)
        return core._replace(excluded={**excluded, RECEIVER: again}, unbounded=False)
    entry = core.excluded.get(RECEIVER)
    if entry is None or not position.passes or (velocity is not None and not velocity.passes):
        return core
    if is_still_carried_off(core, measured, tests, motion):
        still = replace(entry, healthy_since_us=None)
        return core._replace(excluded={**core.excluded, RECEIVER: still})
    since = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
    if (t_us - since) * 1e-6 >= config.readmit_s:
        return core._replace(excluded={}, carried=None)
    healthy = replace(entry, healthy_since_us=since)
    return core._replace(excluded={**core.excluded, RECEIVER: healthy})


def _update_filter(
    motion: MotionEstimate,
    core: DetectorCore,
    hypothesis: str,
    measured: FixMeasurement,
    tests: Tests,
    acceleration_mps2: Vector,
    config: DetectorConfig,
) -> MotionEstimate:
    """The filter after what is trusted of the fix."""
    position, velocity = tests
    if hypothesis in IMU_IN_DOUBT or (hypothesis == "none" and not position.passes):
        motion = free_position(motion)
        position, velocity = run_fix_tests(measured, motion, config)
    before = motion
    if RECEIVER not in core.excluded and position.passes:
        motion = update_with_fix(motion, position)
    if velocity is not None and velocity.passes and RECEIVER_VELOCITY not in core.excluded:
        # Predicted anew, as the position has just moved the filter's velocity, too.
        again = run_fix_tests(measured, motion, config)[1]
        motion = update_with_fix(motion, again if again is not None else velocity)
    return limit_heading_update(before, motion, acceleration_mps2, measured.axes)
