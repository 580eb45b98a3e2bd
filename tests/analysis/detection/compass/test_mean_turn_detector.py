"""Compass and gyro that on average turn otherwise, of a gyro that is logged slowly and shaken."""

import numpy as np
import pytest

from analysis.detection.compass.mean_turn_detector import MeanTurnDetector
from analysis.results import SensorDecision
from analysis.samples.block import block_of
from analysis.samples.sample import ImuSample, MagSample, Sample
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_attitude, rotation_matrix

FIELD = np.array([0.24, 0.0, 0.53])
FORCE = np.array([0.0, 0.0, -9.8])
SHAKES_HZ = 7.3
BEGIN_S, END_S, SECONDS = 30.0, 45.0, 60.0
STEP_US = 4_000


def alarms(
    *,
    bias_rps: tuple[float, float, float] = (0.0, 0.0, 0.0),
    offset_gauss: tuple[float, float, float] = (0.0, 0.0, 0.0),
    stands: bool = False,
    yaw_rps: float = 0.3,
    shakes_rps: float = 1.6,
) -> list[SensorDecision]:
    """A vehicle that is shaken and turns; the gyro is logged at 25 Hz, the compass at 10."""
    rng = np.random.default_rng(6)
    q, samples, field = np.array([1.0, 0.0, 0.0, 0.0]), list[Sample](), FIELD
    for t_us in range(STEP_US, int(SECONDS * 1e6), STEP_US):
        wrong = BEGIN_S * 1e6 <= t_us < END_S * 1e6
        phase = 2.0 * np.pi * SHAKES_HZ * t_us * 1e-6
        rates = shakes_rps * np.array([np.sin(phase), np.cos(phase), 0.0])
        rates[2] = yaw_rps * np.sin(0.2 * t_us * 1e-6)
        q = rotate_attitude(q, *(rates * STEP_US * 1e-6))
        if t_us % 40_000 == 0:
            shown = rates + rng.normal(0.0, 0.01, 3) + wrong * np.array(bias_rps)
            samples.append(ImuSample(t_us, shown, FORCE))
        if t_us % 100_000 == 0:
            if not (wrong and stands):
                field = rotation_matrix(q).T @ FIELD + rng.normal(0.0, 0.002, 3)
            samples.append(MagSample(t_us, field + wrong * np.array(offset_gauss)))
    detector = MeanTurnDetector()
    return [result for _, result in detector.step(block_of(samples), detector.new_state())[0]]


def test_vibration_and_turns_raise_no_alarm() -> None:
    assert alarms() == []


@pytest.mark.parametrize("axis", range(2))
def test_a_biased_gyro_raises_an_alarm_within_seven_seconds(axis: int) -> None:
    bias = np.zeros(3)
    bias[axis] = 0.2
    found = alarms(bias_rps=(bias[0], bias[1], bias[2]))
    assert {result.suspect or result.sensor for result in found} == {"imu"}
    assert BEGIN_S + 3.0 < found[0].t_s < BEGIN_S + 7.0
    assert found[-1].t_s < END_S + 6.0


def test_a_slight_bias_may_be_of_either_sensor() -> None:
    found = alarms(bias_rps=(0.0, 0.113, 0.0), yaw_rps=0.0, shakes_rps=0.2)
    assert {result.suspect for result in found} == {"imu-or-mag"}


def test_a_field_that_jumps_is_the_compass_s_fault() -> None:
    found = alarms(offset_gauss=(0.0, 0.25, 0.0))
    assert {result.suspect or result.sensor for result in found} == {"mag"}
    assert BEGIN_S < found[0].t_s < BEGIN_S + 1.0


def test_a_frozen_compass_is_not_compared_with_the_gyro() -> None:
    assert alarms(stands=True, yaw_rps=0.5) == []
