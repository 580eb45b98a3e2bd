"""Tests for the carry-off of a receiver (slow spoofing) and for its end."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, LastFix
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import ImuSegment
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.receiver.carry_off_windows import (
    CarryOff,
    CarryOffDetection,
    extend_windows,
    fits_carry_off,
    fix_innovation,
    new_windows,
    renew_oldest_window,
    search_windows,
)
from analysis.detection.receiver.fix_latency import mean_acceleration
from analysis.detection.receiver.position_test import FixMeasurement, FixTest, known_or_zero
from analysis.detection.receiver.receiver_or_imu import mean_force
from analysis.samples.sample import Vector

AT_REST_MPS = 0.3  # one sigma of a receiver's horizontal velocity
STEADY_MPS2 = 1.0  # a latency of 0.15 s is then an error of 0.15 m/s
IMPACT_MPS2 = 5.0  # chosen: the mean force of a flight changes by less from fix to fix
Tests = tuple[FixTest, FixTest | None]  # of a fix's position, and of its velocity if known


def detect_carry_off(
    core: DetectorCore,
    predicted: tuple[MotionEstimate, Vector],
    segment: ImuSegment,
    measurement: FixMeasurement,
    tests: Tests,
    config: DetectorConfig,
) -> tuple[DetectorCore, CarryOffDetection | None, Vector | None]:
    """What the windows show after a fix: a carry-off, or a wrong acceleration (3,).

    `predicted` are the filter, moved by the IMU's `segment`, and the transition phi (20, 20). The
    windows begin again after any other finding.
    """
    (position, velocity), (motion, phi) = tests, predicted
    v_ned_mps = measurement.v_ned_mps
    assert core.motion is not None
    moved = motion.inertial and core.motion.inertial and not core.excluded
    if v_ned_mps is None or velocity is None:
        return core._replace(carry=None), None, None
    if not (moved and position.passes and velocity.passes):
        return core._replace(carry=None), None, None
    carry = core.carry if core.carry is not None else new_windows(motion.t_us)
    dt_s = (motion.t_us - core.motion.t_us) * 1e-6
    fix = fix_innovation(measurement, position, velocity, motion.p)
    carry = extend_windows(carry, motion.t_us, dt_s, phi, measurement.axes, fix)
    if _shows_impact(core.last_fix, segment) or _receiver_smooths(core, motion, measurement):
        carry = carry._replace(doubt_us=motion.t_us, impact_us=motion.t_us)
    detection = wrong_mps2 = None
    # A touch-down stops the receiver with a force that the IMU is often too slow to measure.
    if float(np.linalg.norm(known_or_zero(v_ned_mps))) > AT_REST_MPS:
        # One probability for all windows: they overlap almost entirely.
        carry, detection, wrong_mps2 = search_windows(
            carry, motion.t_us, chi_square_threshold(3, config.p_slow)
        )
    if detection is not None:
        return core._replace(carry=None, carried=detection.carried), detection, None
    # A real receiver's velocity is smoothed and late, so a healthy IMU contradicts it.
    if core.latency.variance > 0.0:
        wrong_mps2 = None
    return core._replace(carry=renew_oldest_window(carry, motion.t_us)), None, wrong_mps2


def _shows_impact(last: LastFix | None, segment: ImuSegment) -> bool:
    """Whether the specific force changed too much to be integrated: a collision or hard landing."""
    force = mean_force(segment)
    if last is None or force is None or not last.forces_b_mps2:
        return False
    return float(np.linalg.norm(force - last.forces_b_mps2[0])) > IMPACT_MPS2


def _receiver_smooths(
    core: DetectorCore, motion: MotionEstimate, measurement: FixMeasurement
) -> bool:
    """Whether the acceleration makes a real receiver, late and smoothed, contradict the IMU."""
    assert core.motion is not None
    acceleration = mean_acceleration(core.motion, motion, measurement.axes)
    real = core.latency.variance > 0.0
    return real and float(np.linalg.norm(acceleration)) > STEADY_MPS2


def estimate_carry_off(
    core: DetectorCore, measurement: FixMeasurement, velocity: FixTest | None
) -> DetectorCore:
    """Estimate the carry-off of a receiver that is excluded now, if its velocity shows one."""
    if measurement.v_ned_mps is None or velocity is None or velocity.passes:
        return core
    if core.carried is not None or core.last_fix is None:
        return core
    u_ned_mps = np.zeros(3)
    u_ned_mps[np.isfinite(measurement.v_ned_mps)] = velocity.v
    return core._replace(carried=CarryOff(core.last_fix.t_us, u_ned_mps))


def is_still_carried_off(
    core: DetectorCore, measurement: FixMeasurement, tests: Tests, motion: MotionEstimate
) -> bool:
    """Whether an excluded receiver continues its carry-off: without it the filter is too
    uncertain."""
    position, velocity = tests
    if core.carried is None or velocity is None:
        return False
    fix = fix_innovation(measurement, position, velocity, motion.p)
    return fits_carry_off(core.carried, motion.t_us, fix)
