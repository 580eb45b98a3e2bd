"""Attitude found from nothing: of an IMU that lies still beside a real antenna, and of one that is
shaken faster than it is logged."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.detection import Detector
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import GYRO_BIAS_SIGMA_RPS, PSI
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.block import block_of
from analysis.samples.sample import Epoch, GpsFix, ImuSample, MagSample, Sample
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

EPOCHS, IMU_US = 60, 20_000
ROLL_RAD, HEADING_RAD = 0.1, 0.7
GRAVITY_MPS2 = 9.797  # at the antenna, to a millimetre per second squared


@pytest.fixture(scope="module")
def static(shared_data: Path) -> list[Sample]:
    folder = shared_data / "gnss_static"
    samples = read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    ends = [i for i, sample in enumerate(samples) if isinstance(sample, Epoch)]
    return samples[: ends[EPOCHS]]


def at_rest(samples: Sequence[Sample], with_mag: bool) -> list[Sample]:
    """The recording with an IMU that lies rolled and turned beside the antenna."""
    rng = np.random.default_rng(4)
    roll = np.array([[1, 0, 0], [0, *turn(ROLL_RAD)[0]], [0, *turn(ROLL_RAD)[1]]])
    heading = np.eye(3)
    heading[:2, :2] = turn(HEADING_RAD)
    rot_bn = roll @ heading
    force, field = rot_bn @ [0.0, 0.0, -GRAVITY_MPS2], rot_bn @ [0.3, 0.0, 0.35]
    found: list[Sample] = []
    last_us = None
    for sample in samples:
        if isinstance(sample, Epoch):
            stamps = range(last_us or sample.t_us - IMU_US, sample.t_us, IMU_US)
            for t_us in stamps:
                rates = rng.normal(0.0, 0.002, 3)
                found.append(ImuSample(t_us, rates, force + rng.normal(0.0, 0.02, 3)))
                if with_mag and t_us % 100_000 == 0:
                    found.append(MagSample(t_us, field))
            last_us = sample.t_us
        found.append(sample)
    return found


def turn(angle_rad: float) -> np.ndarray:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, s], [-s, c]])


def test_an_imu_at_rest_is_aligned_with_the_magnetometer_s_heading(static: list[Sample]) -> None:
    detector = Detector()
    results, state = detector.step(block_of(at_rest(static, True)), detector.new_state())
    decisions = [r for r in results if isinstance(r, Decision)]
    assert decisions[-1].mode == "inertial"
    assert not any(decision.alarm for decision in decisions)
    motion = state.core.motion
    assert motion is not None
    lat, lon, _ = geodetic_position(motion.x[:3])
    rot_nb = ned_axes(lat, lon) @ rotation_matrix(motion.x[6:10])
    sigma_rad = np.sqrt(np.diag(motion.p)[6:9]).max()
    roll_rad = math.atan2(rot_nb[2, 1], rot_nb[2, 2])
    heading_rad = math.atan2(rot_nb[1, 0], rot_nb[0, 0])
    assert abs(roll_rad - ROLL_RAD) < 0.02
    assert abs(heading_rad - HEADING_RAD) < 3.0 * sigma_rad
    # From 0.35 rad it grows no faster than by a gyro bias that nothing sees.
    assert sigma_rad < math.hypot(0.35, GYRO_BIAS_SIGMA_RPS * EPOCHS)


def test_without_a_magnetometer_the_heading_of_an_imu_at_rest_stays_unknown(
    static: list[Sample],
) -> None:
    detector = Detector()
    results, _ = detector.step(block_of(at_rest(static, False)), detector.new_state())
    decisions = [r for r in results if isinstance(r, Decision)]
    assert {decision.mode for decision in decisions} == {"start", "free"}
    assert not any(decision.alarm for decision in decisions)


def shaken(seconds: float, rate_hz: int, shaking_rps: float, seed: int) -> list[Sample]:
    """A vehicle that hovers level and points north; its gyro is shaken faster than it is logged,
    so that what is read between two samples is anything."""
    rng, found = np.random.default_rng(seed), list[Sample]()
    for step in range(round(seconds * rate_hz)):
        t_us = round(step * 1e6 / rate_hz)
        rates = rng.normal(0.0, shaking_rps, 3) * [1.0, 1.0, 0.0]
        force = np.array([0.0, 0.0, -GRAVITY_MPS2]) + rng.normal(0.0, 0.1, 3)
        found.append(ImuSample(t_us, rates, force))
        if step % (rate_hz // 5) == 0:
            found.append(MagSample(t_us, np.array([0.21, 0.0, 0.43])))
            v_ned_mps = rng.normal(0.0, 0.05, 3)
            found.append(GpsFix(t_us, 47.0, 8.0, 500.0, v_ned_mps, 3, 12, 0.8, 1.2, "HIL_GPS"))
    return found


def tilt(motion: MotionEstimate) -> tuple[float, float]:
    """How far the filter's vertical is off that of a level vehicle, and its sigma, in rad."""
    lat, lon, _ = geodetic_position(motion.x[:3])
    axes = ned_axes(lat, lon)
    rot_nb = axes @ rotation_matrix(motion.x[6:10])
    variances = np.diag(axes @ motion.p[PSI : PSI + 3, PSI : PSI + 3] @ axes.T)
    return math.acos(min(float(rot_nb[2, 2]), 1.0)), math.sqrt(variances[:2].max())


@pytest.mark.parametrize("shaking_rps", [0.02, 0.3])
def test_an_attitude_from_a_slow_vibrating_imu_has_a_realistic_sigma(
    shaking_rps: float,
) -> None:
    detector, ratios = Detector(), []
    for seed in range(12):
        state = detector.new_state()
        for sample in shaken(12.0, 25, shaking_rps, seed):
            _, state = detector.step(sample, state)
            motion = state.core.motion
            if motion is not None and motion.inertial:
                off_rad, sigma_rad = tilt(motion)
                ratios.append(off_rad / sigma_rad)
                break
    assert len(ratios) == 12
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_a_receiver_is_not_isolated_for_the_attitude_of_a_slow_vibrating_imu() -> None:
    detector = Detector()
    results, state = detector.step(block_of(shaken(90.0, 25, 1.6, 1)), detector.new_state())
    decisions = [r for r in results if isinstance(r, Decision)]
    assert not any(decision.alarm for decision in decisions)
    assert state.core.motion is not None
    assert not state.core.motion.inertial


def test_an_attitude_lost_by_vibration_is_no_evidence_against_the_receiver() -> None:
    calm, rough = shaken(20.0, 25, 0.02, 2), shaken(60.0, 25, 1.6, 3)
    detector = Detector()
    _, state = detector.step(block_of(calm), detector.new_state())
    assert state.core.motion is not None
    assert state.core.motion.inertial
    # Without the receiver's help nothing holds the attitude in place.
    later = [replace(s, t_us=s.t_us + 20_000_000) for s in rough]
    alone = [s for s in later if not isinstance(s, GpsFix) or s.t_us > 24_000_000]
    results, state = detector.step(block_of(alone), state)
    assert not any(r.alarm and r.hypothesis == "gps" for r in results if isinstance(r, Decision))
    assert state.core.motion is not None
    assert not state.core.motion.inertial
