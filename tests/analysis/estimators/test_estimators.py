"""Every estimator follows a flight with turns; the biased ones learn the bias."""

import numpy as np
import pytest

from analysis.estimators import Prior, estimator_names, make_estimator
from analysis.samples.sample import GpsFix, ImuSample, MagSample
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.rotations.rotation_kernel import attitude_errors, quaternion_of_euler

DECLINATION_RAD = float(np.arctan2(0.03, 0.21))


def track(name, flight, after_s=0.0, turn_rad=0.0):
    """Errors (n, 4) in degrees from `after_s` on; the prior is off by `turn_rad` in roll."""
    estimator = make_estimator(name)
    q0 = quaternion_of_euler(turn_rad, np.radians(5.0), 0.0)
    rot_x = np.array([np.cos(np.radians(5.0)), 0.0, -np.sin(np.radians(5.0))])
    state = estimator.start(Prior(0, q0, 25.0 * rot_x, declination_rad=DECLINATION_RAD))
    found = []
    k = 0
    for sample in flight.samples:
        estimate, state = estimator.update(sample, state)
        if isinstance(sample, ImuSample):
            if sample.t_us >= after_s * 1e6:
                found.append(attitude_errors(estimate.q_nb, flight.q_nb[k]))
            k += 1
    return np.degrees(np.array(found))


@pytest.mark.parametrize(
    ("name", "limit_deg"),
    [("inverse-model", 0.3), ("ekf", 0.5), ("mahony", 2.5), ("complementary", 2.5)],
)
def test_an_estimator_follows_turns_without_noise(flights, name, limit_deg):
    error = track(name, flights["clean"])
    assert np.sqrt((error[:, 3] ** 2).mean()) < limit_deg


def test_a_fix_without_vertical_velocity_is_ignored_by_the_ekf():
    ekf = make_estimator("ekf")
    state = ekf.start(Prior(0, quaternion_of_euler(0.0, 0.0, 0.0)))
    v_ned_mps = np.array([20.0, 0.0, np.nan])
    fix = GpsFix(0, 47.0, 8.0, 500.0, v_ned_mps, 3, 10, 1.0, 1.5, "GPS_RAW_INT")
    assert (ekf.update(fix, state)[1].x == state.x).all()


def test_the_ekf_learns_a_gyro_bias_in_turning_flight(flights):
    assert np.abs(track("ekf", flights["biased"], after_s=30.0)[:, 3]).max() < 1.5


def test_without_gps_the_ekf_still_holds_attitude_by_gravity_and_airspeed(flights):
    assert np.abs(track("ekf", flights["no-gps"], after_s=30.0)[:, 3]).max() < 5.0


def test_mahony_learns_a_gyro_bias_and_the_plain_filter_does_not(flights):
    learned = track("mahony", flights["biased"], after_s=40.0)
    plain = track("complementary", flights["biased"], after_s=40.0)
    assert np.sqrt((learned[:, 3] ** 2).mean()) < np.sqrt((plain[:, 3] ** 2).mean())


def test_dead_reckoning_drifts_by_bias_times_time(flights):
    error = track("inverse-model", flights["biased"])
    at_2_s = error[400, 3]
    assert at_2_s == pytest.approx(np.degrees(np.sqrt(14) * 0.01 * 2.0), rel=0.05)


def test_the_ekf_recovers_from_a_wrong_start(flights):
    error = track("ekf", flights["clean"], after_s=20.0, turn_rad=np.radians(20.0))
    assert np.abs(error[:, 3]).max() < 1.5


def test_madgwick_keeps_a_vehicle_at_rest_level_and_north():
    estimator = make_estimator("madgwick")
    q0 = quaternion_of_euler(0.1, -0.1, 0.2)
    state = estimator.start(Prior(0, q0, declination_rad=DECLINATION_RAD))
    for k in range(1, 4000):
        _, state = estimator.update(MagSample(k * 10_000, np.array([0.21, 0.03, 0.42])), state)
        rest = ImuSample(k * 10_000, np.full(3, 1e-9), np.array([0.0, 0.0, -9.80665]))
        estimate, state = estimator.update(rest, state)
    assert np.degrees(attitude_errors(estimate.q_nb, np.array([1.0, 0, 0, 0]))[3]) < 0.5


@pytest.mark.parametrize("name", estimator_names())
def test_a_sample_from_the_past_and_a_long_gap_do_no_harm(name):
    estimator = make_estimator(name)
    state = estimator.start(Prior(1_000_000, np.array([1.0, 0, 0, 0])))
    level = np.array([0.0, 0.0, -9.80665])
    for t_us in (500_000, 1_000_000, 1_010_000, 90_000_000, 90_005_000):
        estimate, state = estimator.update(ImuSample(t_us, np.array([0.1, 0.0, 0.0]), level), state)
    assert np.isfinite(estimate.q_nb).all()
    assert np.degrees(attitude_errors(estimate.q_nb, np.array([1.0, 0, 0, 0]))[3]) < 1.0


@pytest.mark.parametrize("name", estimator_names())
def test_an_update_does_not_change_the_previous_state(name, flights):
    estimator = make_estimator(name)
    state = estimator.start(Prior(0, flights["clean"].q_nb[0]))
    for sample in flights["clean"].samples[:100]:
        _, state = estimator.update(sample, state)
    after = flights["clean"].samples[100:160]
    runs = []
    for _ in range(2):
        moving = state
        for sample in after:
            estimate, moving = estimator.update(sample, moving)
        runs.append(estimate.q_nb)
    assert (runs[0] == runs[1]).all()


def test_an_unknown_estimator_is_the_users_error():
    with pytest.raises(ConfigError, match="known: complementary, ekf"):
        make_estimator("magic")
