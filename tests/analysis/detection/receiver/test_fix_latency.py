"""Fixes that come late, as real receivers' do, and do not say so."""

import numpy as np
import pytest

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.receiver.fix_latency import (
    SIGMA_S,
    USUAL_S,
    Latency,
    append_interval,
    compensate_latency,
    initial_latency,
    mean_acceleration,
    update_latency,
)
from analysis.detection.receiver.position_test import FixMeasurement, run_fix_tests, start_at_fix
from analysis.samples.sample import Vector

TRUE_S = 0.4
AXES = np.eye(3)


def fix(place_m: Vector, velocity_mps: Vector) -> FixMeasurement:
    return FixMeasurement(place_m, AXES, np.ones(3), velocity_mps, np.array([0.09, 0.09, 0.16]))


def flown(seconds: float) -> tuple[list[bool], Latency]:
    """A vehicle that weaves with 4 m/s^2; the filter knows its motion, the fixes are late."""
    latency, passed = initial_latency("GPS_RAW_INT"), []
    before: MotionEstimate | None = None
    for t_s in np.arange(0.0, seconds, 0.2):
        place, velocity = np.zeros(3), np.zeros(3)
        place[0], velocity[0] = -4.0 * np.cos(t_s), 4.0 * np.sin(t_s)
        reported = np.array([4.0 * np.sin(t_s - TRUE_S), 0.0, 0.0])
        now = start_at_fix(round(t_s * 1e6), fix(place, velocity))._replace(inertial=True)
        now = now._replace(p=now.p * 1e-3)
        if before is not None:
            acceleration = mean_acceleration(before, now, AXES)
            latency = append_interval(latency, 0.2, acceleration)
            measured = compensate_latency(fix(place, reported), now, latency)
            _, tested = run_fix_tests(measured, now, DetectorConfig())
            assert tested is not None
            passed.append(tested.passes)
            latency = update_latency(latency, tested, now.p)
        before = now
    return passed, latency


def test_a_late_receiver_is_not_isolated_and_its_latency_is_learned() -> None:
    passed, latency = flown(20.0)
    assert all(passed)
    assert latency.seconds == pytest.approx(TRUE_S, abs=0.05)
    assert latency.variance < 0.06**2


def test_an_unknown_latency_widens_the_test() -> None:
    now = start_at_fix(200_000, fix(np.zeros(3), np.array([10.0, 0.0, 0.0])))._replace(
        inertial=True
    )
    measured = fix(np.zeros(3), np.zeros(3))
    latency = append_interval(initial_latency("GPS_RAW_INT"), 0.2, np.array([3.0, 0.0, 0.0]))
    late = compensate_latency(measured, now, latency)
    assert late.r_ecef_m == pytest.approx([(10.0 - 3.0 * USUAL_S / 2) * USUAL_S, 0, 0])
    assert late.variance_m2 - measured.variance_m2 == pytest.approx([(10 * SIGMA_S) ** 2, 0, 0])
    assert late.v_ned_mps == pytest.approx([3.0 * USUAL_S, 0, 0])
    assert late.v_variance - measured.v_variance == pytest.approx([(3 * SIGMA_S) ** 2, 0, 0])


def test_a_simulators_fix_has_no_latency() -> None:
    now = start_at_fix(200_000, fix(np.zeros(3), np.array([10.0, 0.0, 0.0])))._replace(
        inertial=True
    )
    measured = fix(np.zeros(3), np.zeros(3))
    assert (
        compensate_latency(
            measured, now, append_interval(initial_latency("HIL_GPS"), 0.2, np.ones(3))
        )
        is measured
    )


def test_an_impact_since_a_late_fix_counts_as_long_as_it_lasted() -> None:
    """0.5 s late, ten fixes a second: 20 m/s^2 for 0.1 s are 2 m/s, not 10."""
    latency = Latency(0.5, 0.05**2)
    for acceleration in (0.0, 0.0, 20.0, 0.0):
        latency = append_interval(latency, 0.1, np.array([acceleration, 0.0, 0.0]))
    now = start_at_fix(400_000, fix(np.zeros(3), np.zeros(3)))._replace(inertial=True)
    late = compensate_latency(fix(np.zeros(3), np.zeros(3)), now, latency)
    assert late.v_ned_mps == pytest.approx([2.0, 0, 0])


def test_an_error_of_a_second_hardly_moves_a_well_known_latency() -> None:
    """An IMU 2 m/s^2 off makes the velocities err by up to 1.3 m/s before it is found."""
    _, known = flown(60.0)
    latency, now = (
        known,
        start_at_fix(400_000, fix(np.zeros(3), np.zeros(3)))._replace(inertial=True),
    )
    now = now._replace(p=now.p * 1e-3)
    for error_mps in (0.3, 0.5, 0.7, 0.9, 1.1, 1.3):
        latency = append_interval(latency, 0.2, np.array([2.0, 0.0, 0.0]))
        reported = compensate_latency(
            fix(np.zeros(3), np.array([-error_mps, 0.0, 0.0])), now, latency
        )
        assert reported.v_ned_mps is not None
        reported = reported._replace(v_ned_mps=np.array([-error_mps, 0.0, 0.0]))
        tested = run_fix_tests(reported, now, DetectorConfig())[1]
        assert tested is not None
        latency = update_latency(latency, tested, now.p)
    assert abs(latency.seconds - known.seconds) < 0.02
