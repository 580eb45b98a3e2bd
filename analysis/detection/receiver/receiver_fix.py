"""The decision on a receiver's fix without raw ranges, by tests of its position and velocity.

Three position components have no redundancy, so the fault is isolated by the velocity and by
whether the receiver is consistent with itself. A position that leaves while the velocity still fits
the IMU is the receiver's fault; a velocity that leaves while the receiver's positions move with it
is the receiver's or the IMU's, see `receiver_or_imu`. If these are not separable, the filter
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

RECEIVER_VELOCITY = "gps-velocity"  # the velocity's name among the excluded
IMU_IN_DOUBT = ("imu", UNDECIDED)  # hypotheses after which the IMU is not used for a while
PAUSED_S = 1.5  # without a fix: more than an interval at 1 Hz
LOST_M = 300.0  # sigma above which the filter starts again


def step_position(
    fix: GpsFix, state: DetectorState, config: DetectorConfig
) -> tuple[list[Result], DetectorState]:
    """The decision on one fix and the next state."""
    core, pending, mag_b = state
    # Messages of one receiver are not independent: one is used, HIL_GPS if it is present.
    if core.gps_source not in (None, fix.source) and fix.source != "HIL_GPS":
        return [], state
    latency = core.latency if fix.source == core.gps_source else initial_latency(fix.source)
    core = core._replace(gps_source=fix.source, latency=latency, mag_b=mag_b)
    core = core._replace(repeats=core.repeats.updated(fix.t_us, fix_values(fix)))
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
        decision = build_fix_decision(fix, core, None, None, "none", False, "start")
        return [decision], DetectorState(core, pending, mag_b)
    core = core._replace(imu_interval_s=update_interval_s(core.imu_interval_s, run))
    imu_data = imu_segment(run, motion, fix.t_us)
    predicted, phi = propagate_filter(motion, imu_data, fix.t_us, config)
    acceleration = mean_acceleration(motion, predicted, measurement.axes)
    dt_s = (fix.t_us - motion.t_us) * 1e-6
    core = core._replace(latency=append_interval(core.latency, dt_s, acceleration))
    measurement = compensate_latency(measurement, predicted, core.latency)
    tests = run_fix_tests(measurement, predicted, config)
    hypothesis, alarm = _isolate(core, measurement, predicted, imu_data, tests, config)
    core, detection, wrong_mps2 = detect_carry_off(
        core, (predicted, phi), imu_data, measurement, tests, config
    )
    if detection is not None:
        predicted, hypothesis, alarm = remove_carry_off(predicted, detection), "gps", True
        tests = run_fix_tests(measurement, predicted, config)
    elif wrong_mps2 is not None:
        alarm = True
        hypothesis = isolate_acceleration_fault(
            core.last_fix, wrong_mps2, measurement, predicted, imu_data
        )
    if hypothesis == "none" and tests[1] is not None:
        core = core._replace(latency=update_latency(core.latency, tests[1], predicted.p))
    core = _with_hysteresis(core, hypothesis, measurement, tests, predicted, config)
    updated_motion = _update_filter(
        predicted, core, hypothesis, measurement, tests, acceleration, config
    )
    updated_motion = align_attitude(core, updated_motion, imu_data, dt_s, config)
    core = core._replace(
        motion=updated_motion,
        last_fix=new_last_fix(core.last_fix, measurement, imu_data, updated_motion),
    )
    hypothesis_now = _reported_hypothesis(core, hypothesis)
    mode = "position" if updated_motion.inertial else "position-free"
    results: list[Result] = [build_fix_decision(fix, core, *tests, hypothesis_now, alarm, mode)]
    # Without fixes meanwhile everything had paused.
    paused = dt_s > PAUSED_S and imu_data.gap_s > 0.8 * dt_s
    gap = imu_data.gap_s if (predicted.inertial or motion.inertial) and not paused else 0.0
    results += fix_sensor_decisions(fix, core, *tests, gap, hypothesis, config)
    return results, DetectorState(core, pending, mag_b)


def _restart(core: DetectorCore, motion: MotionEstimate) -> DetectorCore:
    """The state with a new filter, and nothing of the past."""
    return core._replace(
        motion=motion, excluded={}, last_fix=None, unbounded=False, carry=None, carried=None
    )


def _reported_hypothesis(core: DetectorCore, hypothesis: str) -> str:
    """The hypothesis that the decision reports while a sensor is excluded."""
    if hypothesis != "none":
        return hypothesis
    if RECEIVER in core.excluded:
        return "gps"
    if core.imu_bad_until_us is not None:
        return UNDECIDED if core.unbounded else "imu"
    return "none"


def _isolate(
    core: DetectorCore,
    measurement: FixMeasurement,
    motion: MotionEstimate,
    imu_data: ImuSegment,
    tests: Tests,
    config: DetectorConfig,
) -> tuple[str, bool]:
    """The hypothesis for a failed test, and whether it is an alarm; `imu_data` is the IMU since the
    last fix, which moved the filter to `motion`."""
    position, velocity = tests
    # A repeated fix measures nothing, however well it fits.
    if core.repeats.frozen:
        return "gps", True
    if position.passes and (velocity is None or velocity.passes):
        return "none", False
    agrees = _self_consistent(core, measurement, motion.t_us, config)
    if not motion.inertial:  # only steady motion is predicted: it is a position jump or no fault
        return ("none", False) if agrees else ("gps", True)
    if velocity is None or velocity.passes or RECEIVER in core.excluded:
        return "gps", True
    if agrees:
        return isolate_receiver_or_imu(
            core.last_fix, measurement, motion, velocity, imu_data, config
        ), True
    return ("gps", True) if position.passes else ("multiple-unknown", True)


def _self_consistent(
    core: DetectorCore, measurement: FixMeasurement, t_us: int, config: DetectorConfig
) -> bool:
    """Whether the receiver's position moved by its velocities since the last fix.

    They are the velocities at both ends; when the speed changed in between is unknown (at an impact
    it changes at once). So either velocity, or any between, may have moved the position.
    """
    last = core.last_fix
    if last is None or measurement.v_ned_mps is None:
        return True
    dt_s = (t_us - last.t_us) * 1e-6
    known = np.isfinite(measurement.v_ned_mps)
    # Without an earlier velocity it is assumed unchanged.
    earlier = np.where(np.isfinite(last.v_ned_mps), last.v_ned_mps, measurement.v_ned_mps)
    changed = (measurement.v_ned_mps - earlier)[known]
    updated_motion = measurement.axes @ (measurement.r_ecef_m - last.r_ecef_m)
    difference = updated_motion[known] - (measurement.v_ned_mps[known] - changed / 2) * dt_s
    between_m = float(np.linalg.norm(changed)) * dt_s / 2
    unexplained_m = max(float(np.linalg.norm(difference)) - between_m, 0.0)
    variance = 0.5**2 + (VELOCITY_SIGMA_MPS[0] ** 2 + config.noise.motion_mps2**2 * dt_s) * dt_s**2
    q = unexplained_m**2 / variance
    return bool(q <= chi_square_threshold(int(known.sum()), config.p_other))


def _with_hysteresis(
    core: DetectorCore,
    hypothesis: str,
    measurement: FixMeasurement,
    tests: Tests,
    motion: MotionEstimate,
    config: DetectorConfig,
) -> DetectorCore:
    """Exclude or readmit the receiver, and hold out the IMU for a while."""
    (position, velocity), t_us = tests, motion.t_us
    if hypothesis in IMU_IN_DOUBT:
        until_us = t_us + round(config.imu_hold_s * 1e6)
        unbounded = core.unbounded or hypothesis == UNDECIDED
        return core._replace(imu_bad_until_us=until_us, unbounded=unbounded, carry=None)
    if core.imu_bad_until_us is not None and t_us >= core.imu_bad_until_us:
        core = core._replace(imu_bad_until_us=None)
    if hypothesis in ("gps", "multiple-unknown"):
        core = estimate_carry_off(core, measurement, velocity)
        # A receiver that is carried off, or frozen, fits at first.
        position_alone = core.carried is None and not core.repeats.frozen
        names = (RECEIVER,) if position_alone else (RECEIVER, RECEIVER_VELOCITY)
        excluded = add_exclusions(core.excluded, names, t_us, t_us)
        again = replace(excluded[RECEIVER], healthy_since_us=None)
        return core._replace(excluded={**excluded, RECEIVER: again}, unbounded=False)
    entry = core.excluded.get(RECEIVER)
    if entry is None or not position.passes or (velocity is not None and not velocity.passes):
        return core
    if is_still_carried_off(core, measurement, tests, motion):
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
    measurement: FixMeasurement,
    tests: Tests,
    acceleration_mps2: Vector,
    config: DetectorConfig,
) -> MotionEstimate:
    """The filter after an update with the trusted parts of the fix."""
    position, velocity = tests
    if hypothesis in IMU_IN_DOUBT or (hypothesis == "none" and not position.passes):
        motion = free_position(motion)
        position, velocity = run_fix_tests(measurement, motion, config)
    before = motion
    if RECEIVER not in core.excluded and position.passes:
        motion = update_with_fix(motion, position)
    if velocity is not None and velocity.passes and RECEIVER_VELOCITY not in core.excluded:
        # Predicted again, as the position update has moved the filter's velocity too.
        again = run_fix_tests(measurement, motion, config)[1]
        motion = update_with_fix(motion, again if again is not None else velocity)
    return limit_heading_update(before, motion, acceleration_mps2, measurement.axes)
