"""Scores: wrapped, interpolated to the estimate's stamp, split by fault and phase."""

import numpy as np
import pytest

from analysis.samples.block import block_of
from analysis.samples.sample import AttitudeSample, ImuSample, MagSample, TruthSample
from analysis.scoring.attitude_scores import REPEATED, put_repeaters_last
from analysis.scoring.attitude_scoring import (
    AUTOPILOTS,
    AttitudeConfig,
    AttitudeScorer,
    declination_rad,
)
from mavproxy_fault.numerics.rotations.rotation_kernel import attitude_errors, quaternion_of_euler
from mavproxy_fault.wire.label import Label

LEVEL = np.array([0.0, 0.0, -9.80665])


def truth(t_us, roll=0.0, pitch=0.0, yaw=0.0, v_ned=(20.0, 0.0, 0.0)):
    q = quaternion_of_euler(roll, pitch, yaw)
    return TruthSample(t_us, q, np.zeros(3), 47.0, 8.0, 500.0, np.array(v_ned))


def autopilot(t_us, roll=0.0, pitch=0.0, yaw=0.0):
    return AttitudeSample(t_us, quaternion_of_euler(roll, pitch, yaw), 1, "ATTITUDE")


def score(samples, **config):
    scorer = AttitudeScorer(AttitudeConfig(declination_deg=0.0, **config))
    state = scorer.new_state()
    results = []
    for sample in samples:
        found, state = scorer.step(block_of(sample), state)
        results += [result for _, result in found]
    return scorer, state, results


def test_yaw_differences_are_wrapped():
    error = attitude_errors(quaternion_of_euler(0, 0, 3.1), quaternion_of_euler(0, 0, -3.1))
    assert error[2] == pytest.approx(6.2 - 2 * np.pi)
    assert error[3] == pytest.approx(2 * np.pi - 6.2)


def test_an_autopilots_attitude_is_compared_with_the_truth_at_its_own_stamp():
    samples = [truth(0, roll=0.0), autopilot(50_000, roll=0.05), truth(100_000, roll=0.08)]
    _, _, results = score(samples, estimators=())
    assert [r.estimator for r in results] == ["ATTITUDE"]
    assert results[0].roll == pytest.approx(np.degrees(0.01), abs=1e-3)
    assert results[0].t_s == pytest.approx(0.05)


def test_results_are_thinned_and_scores_are_not():
    samples = [truth(0)]
    for k in range(1, 201):
        error = 0.2 if k == 7 else 0.0
        samples += [autopilot(k * 5000, pitch=error), truth(k * 5000)]
    scorer, state, results = score(samples, estimators=(), rate_hz=10.0)
    assert len(results) == 11  # one for each tenth of a second, the last begun
    found = scorer.summary(state)["ATTITUDE"]
    assert found["samples"] == 200
    assert found["rmse_deg"]["pitch"] == pytest.approx(np.degrees(0.2 / np.sqrt(200)))
    assert found["rmse_deg"]["max"] == found["rmse_deg"]["pitch"]
    assert found["max_deg"]["angle"] == pytest.approx(np.degrees(0.2))


def test_errors_within_a_fault_are_counted_apart():
    samples = [truth(0)]
    for k in range(1, 101):
        error = 0.1 if 40 <= k < 60 else 0.0
        samples += [autopilot(k * 100_000, yaw=error), truth(k * 100_000)]
    scorer, state, _ = score(samples, estimators=())
    label = Label(id="f", fault="bias", t0_us=0, start_us=4_000_000, end_us=6_000_000)
    found = scorer.summary(state, [label])["ATTITUDE"]
    assert found["faults"]["f"]["rmse_deg"]["yaw"] == pytest.approx(np.degrees(0.1))
    assert found["nominal"]["max_deg"]["yaw"] == pytest.approx(0.0, abs=1e-9)


def test_flight_phases_are_determined_from_the_truth():
    samples = [
        truth(0), autopilot(10, roll=0.1), truth(100_000, v_ned=(20.0, 0.0, -3.0)),
        autopilot(150_000), truth(200_000, roll=0.5),
    ]  # fmt: skip
    scorer, state, _ = score(samples, estimators=())
    assert set(scorer.summary(state)["ATTITUDE"]["phases"]) == {"climb", "turn"}


def test_an_estimator_starts_at_the_first_truth_and_runs_on_its_imu_only():
    samples = [ImuSample(0, np.full(3, 9.0), LEVEL), truth(0, roll=0.2)]
    for k in range(1, 100):
        samples.append(ImuSample(k * 5000, np.zeros(3), LEVEL))
        samples.append(ImuSample(k * 5000, np.full(3, 9.0), LEVEL, id=1))
        samples.append(truth(k * 5000, roll=0.2))
    scorer, state, _ = score(samples, estimators=("inverse-model",))
    assert scorer.summary(state)["inverse-model"]["max_deg"]["angle"] < 1e-6


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e20, -3e38])
def test_samples_that_are_no_measurement_do_not_reach_an_estimator(value: float):
    samples = [truth(0)]
    for k in range(1, 101):
        gyro = np.array([0.0, value if k == 30 else 0.0, 0.0])
        field = np.array([0.2, 0.0, np.nan if k == 40 else 0.4])
        t_us = k * 10_000
        samples += [ImuSample(t_us, gyro, LEVEL, 0), MagSample(t_us, field), truth(t_us)]
    scorer, state, _ = score(samples)
    found = scorer.summary(state)["ekf"]
    assert found["samples"] == 99
    assert found["max_deg"]["angle"] < 1.0


def test_an_attitude_that_is_no_number_is_wrong_by_half_a_turn():
    lost = AttitudeSample(50_000, np.full(4, np.nan), 1, "ATTITUDE")
    _, _, results = score([truth(0), lost, truth(100_000)], estimators=())
    assert (results[0].yaw, results[0].angle) == (180.0, 180.0)


def test_an_estimate_that_comes_late_is_compared_with_the_truth_of_its_own_time():
    samples = [truth(k * 100_000, roll=0.02 * k) for k in range(5)]
    samples += [autopilot(150_000, roll=0.05), truth(500_000, roll=0.1)]
    _, _, results = score(samples, estimators=())
    assert results[0].roll == pytest.approx(np.degrees(0.02), abs=1e-3)


def test_an_estimate_from_before_the_truth_that_is_kept_does_not_count():
    samples = [truth(k * 100_000) for k in range(30)]
    samples += [autopilot(150_000, roll=0.05), truth(3_000_000)]
    _, _, results = score(samples, estimators=())
    assert results == []


def test_a_pause_of_the_truth_is_not_interpolated_over():
    _, _, results = score([truth(0), autopilot(500_000), truth(5_000_000)], estimators=())
    assert results == []


def test_an_autopilot_that_only_repeats_the_truth_is_called_so_and_comes_last():
    samples = [truth(0)]
    for k in range(1, 101):
        samples += [ImuSample(k * 5000, np.array([0.0, 0.1, 0.0]), LEVEL), autopilot(k * 5000)]
        samples.append(truth(k * 5000))
    scorer, state, _ = score(samples, estimators=("inverse-model",))
    found = put_repeaters_last(scorer.summary(state), AUTOPILOTS)
    assert list(found) == ["inverse-model", "ATTITUDE" + REPEATED]
    wrong = [truth(0), *(autopilot(k * 5000, roll=0.001) for k in range(1, 100)), truth(500_000)]
    scorer, state, _ = score(wrong, estimators=())
    assert list(put_repeaters_last(scorer.summary(state), AUTOPILOTS)) == ["ATTITUDE"]


def test_declination_at_provo_is_that_of_the_world_magnetic_model():
    # about 11 degrees east of north at Provo, Utah, in 2025
    from_boot = np.degrees(declination_rad(40.2, -111.7, 1400.0, 5_000_000))
    assert from_boot == pytest.approx(10.9, abs=0.3)
    # It falls by a tenth of a degree a year there.
    in_2015 = np.degrees(declination_rad(40.2, -111.7, 1400.0, 1_420_070_400_000_000))
    assert in_2015 - from_boot == pytest.approx(1.0, abs=0.3)
    in_1990 = declination_rad(40.2, -111.7, 1400.0, 631_152_000_000_000)
    assert np.degrees(in_1990) == from_boot
