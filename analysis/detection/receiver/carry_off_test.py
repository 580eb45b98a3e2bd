"""A receiver that is being carried off, and one left out for it that is not yet back."""

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

AT_REST_MPS = 0.3
STEADY_MPS2 = 1.0
IMPACT_MPS2 = 5.0  # more than a flight's own change of mean force from fix to fix
Tests = tuple[FixTest, FixTest | None]  # of a fix's position, and of its velocity where it is known


def detect_carry_off(
    core: DetectorCore,
    predicted: tuple[MotionEstimate, Vector],
    part: ImuSegment,
    measured: FixMeasurement,
    tests: Tests,
    config: DetectorConfig,
) -> tuple[DetectorCore, CarryOffDetection | None, Vector | None]:
    """What the windows say after a fix, before which the IMU's `part` moved the filter; `predicted`
    are the filter then and the transition phi (20, 20): a receiver that is carried off, or a wrong
    acceleration (3,). They begin anew behind all else that was found."""
    (position, velocity), (motion, phi) = tests, predicted
    v_ned_mps = measured.v_ned_mps
    assert core.motion is not None
    moved = motion.inertial and core.motion.inertial and not core.excluded
    if v_ned_mps is None or velocity is None:
        return core._replace(carry=None), None, None
    if not (moved and position.passes and velocity.passes):
        return core._replace(carry=None), None, None
    carry = core.carry if core.carry is not None else new_windows(motion.t_us)
    dt_s = (motion.t_us - core.motion.t_us) * 1e-6
    fix = fix_innovation(measured, position, velocity, motion.p)
    carry = extend_windows(carry, motion.t_us, dt_s, phi, measured.axes, fix)
    if _shows_impact(core.last_fix, part) or _receiver_smooths(core, motion, measured):
        carry = carry._replace(doubt_us=motion.t_us, impact_us=motion.t_us)
    found = wrong_mps2 = None
    # Touching down stops a receiver, by a force that an IMU is often too slow to show.
    if float(np.linalg.norm(known_or_zero(v_ned_mps))) > AT_REST_MPS:
        # One share for all windows: they overlap nearly whole, and what they say changes slowly.
        carry, found, wrong_mps2 = search_windows(
            carry, motion.t_us, chi_square_threshold(3, config.p_slow)
        )
    if found is not None:
        return core._replace(carry=None, carried=found.carried), found, None
    # A real receiver smooths its velocity and comes late, so that a sound IMU contradicts it.
    if core.latency.variance > 0.0:
        wrong_mps2 = None
    return core._replace(carry=renew_oldest_window(carry, motion.t_us)), None, wrong_mps2


def _shows_impact(last: LastFix | None, part: ImuSegment) -> bool:
    """Whether the specific force changed by so much since the last fix that its integral is not
    to be relied upon: a collision or a hard landing."""
    force = mean_force(part)
    if last is None or force is None or not last.forces_b_mps2:
        return False
    return float(np.linalg.norm(force - last.forces_b_mps2[0])) > IMPACT_MPS2


def _receiver_smooths(core: DetectorCore, motion: MotionEstimate, measured: FixMeasurement) -> bool:
    """Whether the vehicle accelerates so that a real receiver, which comes late and smooths its
    velocity, contradicts an IMU."""
    assert core.motion is not None
    acceleration = mean_acceleration(core.motion, motion, measured.axes)
    real = core.latency.variance > 0.0
    return real and float(np.linalg.norm(acceleration)) > STEADY_MPS2


def estimate_carry_off(
    core: DetectorCore, measured: FixMeasurement, velocity: FixTest | None
) -> DetectorCore:
    """With what a receiver that is left out now is moved by, where its velocity shows it."""
    if measured.v_ned_mps is None or velocity is None or velocity.passes:
        return core
    if core.carried is not None or core.last_fix is None:
        return core
    u_ned_mps = np.zeros(3)
    u_ned_mps[np.isfinite(measured.v_ned_mps)] = velocity.v
    return core._replace(carried=CarryOff(core.last_fix.t_us, u_ned_mps))


def is_still_carried_off(
    core: DetectorCore, measured: FixMeasurement, tests: Tests, motion: MotionEstimate
) -> bool:
    """Whether a receiver that was left out for it goes on as it was carried: without it the filter
    grows so unsure that its position, however wrong, fits."""
    position, velocity = tests
    if core.carried is None or velocity is None:
        return False
    fix = fix_innovation(measured, position, velocity, motion.p)
    return fits_carry_off(core.carried, motion.t_us, fix)
