"""A receiver's clock that runs away."""

import numpy as np
import pytest

from analysis.detection.detector_state import DetectorCore, EpochRecord
from analysis.detection.filter.ephemerides import BroadcastData
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, ERROR_SIZE, X_DRIFT, X_SIZE
from analysis.detection.stages.clock_drift import clock_results
from analysis.samples.sample import Vector


def motion(t_s: float, drift_mps: float, sigma_mps: float) -> MotionEstimate:
    x, p = np.zeros(X_SIZE), np.zeros((ERROR_SIZE, ERROR_SIZE))
    x[X_DRIFT], p[DRIFT, DRIFT] = drift_mps, sigma_mps**2
    return MotionEstimate(round(t_s * 1e6), x, p)


def alarms(drifts_mps: Vector, every_s: float, sigma_mps: float = 0.1) -> list[int]:
    """The epochs, by number, at which a filter with these drifts raises an alarm."""
    history: tuple[EpochRecord, ...] = ()
    numbers = []
    for number, drift in enumerate(drifts_mps):
        now = motion(number * every_s, drift, sigma_mps)
        if clock_results(now, history):
            numbers.append(number)
        core = DetectorCore(now, BroadcastData({}, np.zeros(9)))
        # Neither ranges nor IMU samples are read.
        history = (*history, EpochRecord(now.t_us, core, None, None))  # type: ignore[arg-type]
    return numbers


@pytest.mark.parametrize("every_s", [0.2, 1.0])
def test_a_clock_that_runs_away_raises_alarms_for_a_second(every_s: float) -> None:
    drifts = np.repeat([100.0, 130.0], 20)
    assert alarms(drifts, every_s) == list(range(20, 20 + round(1.0 / every_s)))


def test_a_warming_crystal_and_an_uncertain_clock_raise_no_alarm() -> None:
    assert not alarms(np.arange(100) * 0.2 * 10.0, 0.2)  # 33 nanoseconds each second, every second
    assert not alarms(np.repeat([0.0, 30.0], 20), 0.2, sigma_mps=2.0)


def test_after_a_gap_there_is_no_result() -> None:
    assert not alarms(np.array([0.0, 0.0, 200.0]), 3.0)
