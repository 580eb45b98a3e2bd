"""The antenna's lever arm on a body that turns on the spot."""

import math

import numpy as np
import pytest

from analysis.detection import DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, X_SIZE, gravity_ecef
from analysis.detection.filter.propagation import predict, shift_by_lever_arm
from analysis.monitor.pipeline import monitor_config
from analysis.samples.block import ImuRun
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_in_reference, rotation_matrix

ARM_M = np.array([1.5, -0.5, -0.3])
RATE_RPS = 0.8
POLE_M = np.array([0.0, 0.0, 6_356_752.3])  # where up is along the earth's axis


def gravity_at_the_pole() -> float:
    return float(-gravity_ecef(POLE_M)[2])


def turning_body(at_s: float) -> np.ndarray:
    """The state of the IMU on the pole, level and turning to the right at `RATE_RPS` (ECEF)."""
    x = np.zeros(X_SIZE)
    x[:3] = POLE_M
    half = 0.5 * RATE_RPS * at_s
    spun = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])  # about down
    x[6:10] = rotate_in_reference(spun, math.pi, 0.0, 0.0)  # down is against the axis
    return x


def readings(until_us: int, step_us: int = 5000) -> ImuRun:
    """What the IMU reads: its own turn and the earth's, and what holds it up."""
    stamps = np.arange(step_us, until_us, step_us)
    row = [0.0, 0.0, RATE_RPS - GNSS_EARTH_RATE_RPS, 0.0, 0.0, -gravity_at_the_pole()]
    return ImuRun(stamps, np.tile(row, (len(stamps), 1)))


def antenna_at(at_s: float) -> np.ndarray:
    x = turning_body(at_s)
    return x[:3] + rotation_matrix(x[6:10]) @ ARM_M


def test_the_antenna_rotates_about_an_imu_at_rest():
    config = DetectorConfig(antenna_b_m=tuple(ARM_M))
    x = turning_body(0.0)
    x[:3] = antenna_at(0.0)
    x[3:6] = (antenna_at(1e-4) - antenna_at(-1e-4)) / 2e-4
    start = MotionEstimate(0, x, 1e-4 * np.eye(ERROR_SIZE), True)
    end = predict(start, readings(2_000_000), 2_000_000, config).motion
    assert end.x[:3] == pytest.approx(antenna_at(2.0), abs=0.01)
    assert end.x[3:6] == pytest.approx((antenna_at(2.0001) - antenna_at(1.9999)) / 2e-4, abs=0.01)
    straight = predict(start, readings(2_000_000), 2_000_000, DetectorConfig()).motion
    assert np.linalg.norm(straight.x[:3] - antenna_at(2.0)) > 1.0


def changed(x: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The state that is true where x is believed and wrong by `error` (20,)."""
    out = x.copy()
    out[:6] += error[:6]
    out[6:10] = rotate_in_reference(x[6:10], *error[6:9])
    out[10:] += error[9:]
    return out


def test_errors_transform_as_states_do():
    gyro = np.array([0.1, -0.2, RATE_RPS])
    x, p = turning_body(0.7), np.eye(ERROR_SIZE)
    here, _, turn = shift_by_lever_arm(x, p, gyro, ARM_M, 1.0)
    for i in range(12):
        error = np.zeros(ERROR_SIZE)
        error[i] = 1e-5
        there = shift_by_lever_arm(changed(x, error), p, gyro, ARM_M, 1.0)[0]
        assert (there[:6] - here[:6]) / 1e-5 == pytest.approx(turn[:6, i], abs=1e-3), i


def test_a_shift_there_and_back_changes_nothing():
    gyro = np.array([0.1, -0.2, RATE_RPS])
    x, p = turning_body(0.7), np.diag(np.linspace(1.0, 2.0, ERROR_SIZE))
    there, wide, _ = shift_by_lever_arm(x, p, gyro, ARM_M, 1.0)
    back, narrow, _ = shift_by_lever_arm(there, wide, gyro, ARM_M, -1.0)
    assert back == pytest.approx(x, abs=1e-8)
    assert narrow == pytest.approx(p, abs=1e-8)


def test_an_antenna_without_a_place_is_refused():
    with pytest.raises(ConfigError, match="antenna_b_m"):
        monitor_config({"antenna_b_m": [1.0, 2.0]}, "x")
