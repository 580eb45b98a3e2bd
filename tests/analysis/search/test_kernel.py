"""The batched kernels: the simulator's truth, the estimators' arithmetic, the proxy's faults."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.estimators import make_estimator
from analysis.search.breakdown import case_breakdown
from analysis.search.evaluation.compiled_batch import Batch, start_filters
from analysis.search.evaluation.traced_flight import estimate_attitude, trace_flight
from analysis.search.lanes import rows
from analysis.search.space.test_file import (
    NO_ENVELOPE,
    FaultRange,
    FlightEnvelope,
    InitialState,
    Mission,
    SearchControls,
    SearchSensors,
    SteadyWind,
    TestFile,
)
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat
from simvehicle.vehicles.vehicle import pack_surroundings

QUIET = SearchSensors(
    gyro_sigma_dps=0.0,
    accel_sigma_mps2=0.0,
    field_sigma_gauss=0.0,
    velocity_sigma_mps=0.0,
    pressure_sigma_pa=0.0,
)
WEAVE = Mission(roll_deg=35.0, period_s=12.0)


def test_of(**changes):
    return TestFile(**({"duration_s": 10.0, "noise_draws": 1} | changes))


test_of.__test__ = False


def flown(test, number=0):
    """One flight of a test without ranges."""
    batch = Batch(test)
    column = batch.columns(batch.space.values(np.zeros((1, batch.space.dimension))))
    filters = start_filters(test.estimator, column)[0]
    return trace_flight(batch.plan, column[:, 0], filters, test.seed, number)


SMALL = st.floats(-1.0, 1.0)


@settings(deadline=None, max_examples=25)
@given(
    attitude=st.tuples(SMALL, SMALL, SMALL),
    rates=st.tuples(SMALL, SMALL, SMALL),
    surfaces=st.tuples(SMALL, SMALL, SMALL),
    throttle=st.floats(0.0, 1.0),
    wind=st.tuples(SMALL, SMALL, SMALL),
)
def test_lanes_and_the_simulator_fly_the_same(attitude, rates, surfaces, throttle, wind):
    """The one dynamics code in its two forms: many vehicles in lanes, and a single one."""
    roll, pitch, yaw = (60.0 * x for x in attitude)
    p, q, r = (40.0 * x for x in rates)
    test = test_of(
        duration_s=2.0,
        initial=InitialState(
            roll_deg=roll, pitch_deg=0.5 * pitch, yaw_deg=yaw, p_dps=p, q_dps=q, r_dps=r
        ),
        controls=SearchControls(
            elevator_deg=8.0 * surfaces[0],
            aileron_deg=8.0 * surfaces[1],
            rudder_deg=8.0 * surfaces[2],
            throttle=throttle,
        ),
        wind=SteadyWind(north_mps=8.0 * wind[0], east_mps=8.0 * wind[1], down_mps=2.0 * wind[2]),
        envelope=FlightEnvelope(
            **{**NO_ENVELOPE, "alpha_deg": 90.0}
        ),  # the lanes compare its tangent
    )
    flight = flown(test)
    vehicle = Batch(test).airframe
    after, _ = vehicle.advance(
        np.append(flight.state[0], 0.0),
        np.append(np.radians(8.0 * np.array(surfaces)) / vehicle.throw_rad, throttle),
        pack_surroundings(
            np.array([8.0 * wind[0], 8.0 * wind[1], 2.0 * wind[2]]),
            np.array([0.0, 0.0, 9.80665]),
            1.225,
            0.0,
            np.empty(9),
        ),
        200,
        0.01,
    )
    assert flight.state[200] == pytest.approx(after[:13], rel=1e-9, abs=1e-8)


def test_sensors_without_noise_show_the_truth():
    flight = flown(test_of(sensors=QUIET, mission=WEAVE, estimator="ekf"))
    k = 740  # a sample of the field, of GPS and of airspeed
    assert flight.measured[k, 0:3] == pytest.approx(flight.state[k, 10:13])
    speed = np.linalg.norm(flight.measured[k, 9:12])
    assert speed == pytest.approx(np.linalg.norm(flight.state[k, 3:6]))
    assert flight.measured[k, 12] == pytest.approx(0.5 * 1.225 * speed**2)
    assert np.linalg.norm(flight.measured[k, 6:9]) == pytest.approx(0.48)


def test_specific_force_without_noise_integrates_to_the_velocity():
    flight = flown(test_of(sensors=QUIET, mission=WEAVE))
    assert flight.estimate[-1, 3:6] == pytest.approx(flight.state[-1, 3:6], abs=0.01)
    assert flight.estimate[-1, 6:9] == pytest.approx(flight.state[-1, 0:3], abs=0.1)


NO_GPS = FaultRange(fault="drop", target="HIL_GPS", at_s=2.0, for_s=5.0)


@pytest.mark.parametrize(
    ("name", "faults"),
    [
        ("inverse-model", []),
        ("mahony", []),
        ("complementary", []),
        ("ekf", []),
        ("ekf", [NO_GPS]),  # gravity takes over after two seconds
    ],
)
def test_an_estimator_in_the_kernel_is_the_one_in_python(name, faults):
    flight = flown(test_of(estimator=name, mission=WEAVE, faults=faults))
    again = estimate_attitude(flight, make_estimator(name))
    assert np.abs(flight.q_estimate - again).max() < 1e-9


def test_scores_are_those_of_the_trace():
    test = test_of(mission=WEAVE, criterion="angle")
    batch = Batch(test)
    outcome = batch.evaluate(np.zeros((1, 0)), seed=1, first=0)
    error = np.degrees(flown(test).errors_rad())
    assert outcome.rmse_deg[0] == pytest.approx(np.sqrt((error**2).mean(axis=0)), rel=1e-6)
    assert outcome.largest_deg[0] == pytest.approx(np.abs(error).max(axis=0), rel=1e-6)
    assert outcome.fitness[0] == outcome.rmse_deg[0, 3]


def test_noise_belongs_to_the_evaluation_not_to_its_neighbours():
    test = test_of(initial=InitialState(roll_deg=(-20.0, 20.0)), noise_draws=3)
    points = np.linspace(0.1, 0.9, 40)[:, None]
    together = Batch(test).evaluate(points, seed=5, first=100).fitness
    alone = [
        Batch(test).evaluate(points[i : i + 1], 5, 100 + i).fitness[0] for i in range(0, 40, 5)
    ]
    assert together[::5].tolist() == alone


def test_noise_has_the_sigma_it_was_given():
    flight = flown(test_of(duration_s=60.0))
    noise = flight.measured[:, 0:3] - flight.state[:, 10:13]
    n = noise.size
    ratio = noise.var() / math.radians(0.13) ** 2
    assert abs(ratio - 1.0) < 4.0 * math.sqrt(2.0 / n)
    assert abs(noise.mean()) < 4.0 * math.radians(0.13) / math.sqrt(n)


@pytest.mark.parametrize(
    ("fault", "value", "expected"),
    [
        ("bias", 0.2, lambda x, t: x + 0.2),
        ("drift", 0.1, lambda x, t: x + 0.1 * t),
        ("scale", 3.0, lambda x, t: 3.0 * x),
        ("constant", 0.3, lambda x, t: 0.3 + 0.0 * x),
        ("freeze", 0.0, lambda x, t: x[0] + 0.0 * x),
    ],
)
def test_a_fault_acts_in_its_time_only(fault, value, expected):
    broken = FaultRange(fault=fault, target="HIL_SENSOR.ygyro", value=value, at_s=2.0, for_s=3.0)
    healthy = flown(test_of(mission=WEAVE)).measured
    faulty = flown(test_of(mission=WEAVE, faults=[broken])).measured
    times = np.arange(200, 500) * 0.01 - 2.0
    assert faulty[200:500, 1] == pytest.approx(expected(healthy[200:500, 1], times))
    assert (faulty[:200] == healthy[:200]).all()
    assert (faulty[500:] == healthy[500:]).all()
    assert (faulty[:, [0, 2, 3, 4, 5]] == healthy[:, [0, 2, 3, 4, 5]]).all()


def test_a_fault_on_a_slow_sensor_is_not_applied_twice_to_one_sample():
    broken = FaultRange(fault="scale", target="HIL_GPS.vn", value=2.0)
    test = test_of(estimator="ekf", sensors=QUIET, faults=[broken])
    measured = flown(test).measured[20:, 9]  # from the first sample on
    assert measured == pytest.approx(np.full(len(measured), measured[0]), rel=1e-3)


def test_a_flight_that_leaves_the_envelope_scores_by_how_long_it_lasted():
    test = test_of(controls=SearchControls(elevator_deg=(-25.0, -4.0)), duration_s=20.0)
    outcome = Batch(test).evaluate(np.array([[0.0], [0.5], [1.0]]), 1, 0)
    assert (outcome.broken_limit[:2] > 0).all()
    assert outcome.fitness[0] < outcome.fitness[1] < 0.0
    assert rows.LIMITS[outcome.broken_limit[0]] in ("alpha", "load", "pitch", "rate")


def test_a_mission_rolls_from_side_to_side():
    flight = flown(test_of(mission=WEAVE, sensors=QUIET, duration_s=24.0))
    roll = np.degrees(euler_from_quat(flight.state[:, 6:10])[:, 0])
    assert roll.max() == pytest.approx(35.0, abs=6.0)
    assert roll.min() == pytest.approx(-35.0, abs=6.0)
    assert flight.alive.all()


def test_an_estimator_that_is_not_compiled_is_searched_too():
    test = test_of(estimator="madgwick", mission=WEAVE, criterion="angle", duration_s=3.0)
    outcome = Batch(test).evaluate(np.zeros((1, 0)), seed=1, first=0)
    again = Batch(test).evaluate(np.zeros((1, 0)), seed=1, first=0)
    assert 0.0 < outcome.fitness[0] < 30.0
    assert outcome.fitness[0] == again.fitness[0]
    other = Batch(test_of(mission=WEAVE, criterion="angle", duration_s=3.0))
    assert other.evaluate(np.zeros((1, 0)), seed=1, first=0).fitness[0] < outcome.fitness[0]


def test_an_unknown_estimator_is_the_users_error():
    with pytest.raises(ConfigError, match="known: complementary"):
        Batch(test_of(estimator="guess")).evaluate(np.zeros((1, 0)), 1, 0)


def test_a_noise_fault_adds_noise_of_its_sigma_to_its_channel_only():
    broken = FaultRange(fault="noise", target="HIL_SENSOR.zgyro", value=0.2, at_s=2.0, for_s=30.0)
    healthy = flown(test_of(mission=WEAVE, duration_s=40.0)).measured
    faulty = flown(test_of(mission=WEAVE, duration_s=40.0, faults=[broken])).measured
    added = (faulty - healthy)[200:3200, 2]
    assert abs(added.var() / 0.2**2 - 1.0) < 4.0 * math.sqrt(2.0 / len(added))
    assert abs(np.corrcoef(added, healthy[200:3200, 2])[0, 1]) < 4.0 / math.sqrt(len(added))
    assert (faulty[:, [0, 1, 3, 4, 5]] == healthy[:, [0, 1, 3, 4, 5]]).all()


def test_gusts_shake_the_aircraft_by_chance_of_their_own():
    test = test_of(mission=WEAVE, gusts="moderate")
    first, again, other = flown(test), flown(test), flown(test, number=1)
    calm = flown(test_of(mission=WEAVE))
    assert (first.state == again.state).all()
    assert np.abs(first.state[-1, :3] - other.state[-1, :3]).max() > 0.5
    assert first.state[1] == pytest.approx(calm.state[1])  # gusts begin after the first step
    noise = first.measured[:, 0:3] - first.state[:, 10:13]
    assert noise == pytest.approx(calm.measured[:, 0:3] - calm.state[:, 10:13])


def test_twelve_states_are_scored_in_their_scales():
    test = test_of(mission=WEAVE, criterion="state")
    fitness = Batch(test).evaluate(np.zeros((1, 0)), seed=1, first=0).fitness[0]
    parts = case_breakdown(test, Batch(test).space.fixed, 1, 0)
    scales = np.repeat([10.0, 1.0, 1.0, 1.0], 3)
    rmse = np.array(list(parts["state_rmse"].values()))
    assert fitness == pytest.approx(np.sqrt(((rmse / scales) ** 2).mean()), rel=1e-6)


def test_a_case_is_broken_down_by_phase_and_by_fault():
    broken = FaultRange(fault="bias", target="HIL_SENSOR.xgyro", value=0.1, at_s=4.0, for_s=2.0)
    test = test_of(mission=WEAVE, faults=[broken])
    parts = case_breakdown(test, Batch(test).space.fixed, 1, 0)
    assert set(parts["phases"]) >= {"turn"}
    assert sum(p["samples"] for p in parts["phases"].values()) == parts["samples"] == 1001
    assert parts["faults"]["drawn-0"]["samples"] == 200
    assert parts["faults"]["drawn-0"]["max_deg"]["roll"] == pytest.approx(11.4, abs=1.0)
    assert parts["angle_percentiles_deg"]["50"] <= parts["angle_percentiles_deg"]["99"]
