"""Compiled flights: the samples that the proxy passes on, its faults on them, and their scores."""

import math
from collections.abc import Mapping

import msgspec
import numpy as np
import pytest

from analysis.run.proxied_flight import ProxiedFlight
from analysis.samples.block import AIRSPEED, BARO, FIX, IMU, MAG, Block
from analysis.samples.decoder import Decoder
from analysis.search.evaluation.compiled_flight import sampled_flight
from analysis.search.evaluation.compiled_score import (
    EstimatedFlight,
    fly_estimated,
    score_compiled,
)
from analysis.search.evaluation.envelope import LIMITS
from analysis.search.evaluation.evaluator import Evaluator, score_flight
from analysis.search.space.fault_range import FaultRange
from analysis.search.space.point_scenario import document_of
from analysis.search.space.sample_faults import break_samples
from analysis.search.space.test_file import (
    InitialState,
    Mission,
    SearchControls,
    TestFile,
)
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.scenario.scenario_file import Scenario
from tests.analysis.search.quiet_sensors import QUIET

WEAVE = Mission(roll_deg=35.0, period_s=12.0)
# Half a step of each field on the wire, by kind and column: centimetres a second and 1e-7 degrees
# of GPS, and 32 bits of all others.
STEPS = {FIX: (0.5e-7, 0.5e-7, 0.5e-3, 0.005, 0.005, 0.005)}


def test_of(**changes: object) -> TestFile:
    return TestFile(**({"duration_s": 10.0} | changes))


test_of.__test__ = False


def flown(test: TestFile, seed: int = 1) -> EstimatedFlight:
    """One flight of a test without ranges."""
    return fly_estimated(test, Evaluator(test).space.fixed, seed)


def proxied_samples(document: Mapping[str, object], faults: list[dict[str, object]]) -> Block:
    """The samples that the proxy passes on of a flight of a scenario."""
    scenario = msgspec.convert({k: v for k, v in document.items() if k != "monitor"}, Scenario)
    schedule = parse_schedule({"seed": 1, "faults": faults}, "the test")
    flight, sent = ProxiedFlight(scenario, schedule), bytearray()
    while not flight.finished:
        sent += flight.advance([]).monitor
    frames = Parser().push(bytes(sent))
    return Decoder().decode(one for one in frames if isinstance(one, Frame))


@pytest.mark.parametrize("vehicle", ["aerosonde-2012", "iris"])
def test_the_samples_are_those_that_the_proxy_passes_on(vehicle: str) -> None:
    test = test_of(
        vehicle=vehicle, duration_s=3.0, mission=Mission(roll_deg=20.0), gusts="moderate",
        initial=InitialState(height_m=300.0),
    )  # fmt: skip
    document = document_of(test, Evaluator(test).space.fixed, 7)
    own, proxied = sampled_flight(test, document).samples, proxied_samples(document, [])
    for kind, columns in ((IMU, 6), (MAG, 3), (BARO, 1), (AIRSPEED, 1), (FIX, 6)):
        values, passed = own.values[own.kind == kind], proxied.values[proxied.kind == kind]
        assert len(values) == len(passed)
        # The vehicle's clock starts a second before the flight.
        passed_us = proxied.t_us[proxied.kind == kind] - 1_000_000
        assert (own.t_us[own.kind == kind] == passed_us).all()
        for column in range(columns):
            step = STEPS.get(kind, [1e-5] * columns)[column]
            assert values[:, column] == pytest.approx(passed[:, column], rel=2e-7, abs=1.01 * step)


@pytest.mark.parametrize(
    ("fault", "target", "value"),
    [
        ("bias", "HIL_SENSOR.ygyro", 0.2),
        ("drift", "HIL_SENSOR.zacc", 0.1),
        ("scale", "HIL_SENSOR.xmag", 3.0),
        ("constant", "HIL_SENSOR.diff_pressure", 0.3),
        ("freeze", "HIL_SENSOR.ygyro", None),
        ("bias", "HIL_SENSOR.abs_pressure", 2.0),
        ("bias", "HIL_GPS.lat", 1000.0),
        ("bias", "HIL_GPS.alt", -2500.0),
        ("drift", "HIL_GPS.ve", 100.0),
        ("drop", "HIL_GPS", None),
    ],
)
def test_a_fault_is_that_of_the_proxy(fault: str, target: str, value: float | None) -> None:
    test = test_of(mission=WEAVE, duration_s=4.0)
    document = document_of(test, Evaluator(test).space.fixed, 3)
    entry: dict[str, object] = {"fault": fault, "target": target, "at_s": 1.0, "for_s": 1.5}
    entry |= {} if value is None else {"value": value}
    own = break_samples(sampled_flight(test, document).samples, [entry], 1)
    proxied = proxied_samples(document, [entry])
    healthy = sampled_flight(test, document).samples
    assert len(own.kind) < len(healthy.kind) or (own.values != healthy.values).any()
    for kind, columns in ((IMU, 6), (MAG, 3), (BARO, 1), (AIRSPEED, 1), (FIX, 6)):
        values, passed = own.values[own.kind == kind], proxied.values[proxied.kind == kind]
        assert len(values) == len(passed)
        for column in range(columns):
            # A fault doubles the rounding: of the value, and of its change.
            step = STEPS.get(kind, [1e-5] * columns)[column]
            assert values[:, column] == pytest.approx(passed[:, column], rel=2e-6, abs=2.1 * step)


def test_a_noise_fault_adds_noise_of_its_sigma_to_its_field_only() -> None:
    broken = FaultRange(fault="noise", target="HIL_SENSOR.zgyro", value=0.2, at_s=2.0, for_s=30.0)
    healthy = flown(test_of(mission=WEAVE, duration_s=40.0)).imu
    faulty = flown(test_of(mission=WEAVE, duration_s=40.0, faults=[broken])).imu
    added = (faulty - healthy)[200:3200, 2]
    assert abs(added.var() / 0.2**2 - 1.0) < 4.0 * math.sqrt(2.0 / len(added))
    assert abs(np.corrcoef(added, healthy[200:3200, 2])[0, 1]) < 4.0 / math.sqrt(len(added))
    assert (faulty[:, [0, 1, 3, 4, 5]] == healthy[:, [0, 1, 3, 4, 5]]).all()


def test_sensors_without_noise_show_the_truth() -> None:
    flight = flown(test_of(sensors=QUIET, mission=WEAVE))
    assert flight.imu[:, :3] == pytest.approx(flight.truth[:, 10:13])
    field = flight.samples.values[flight.samples.kind == MAG, :3]
    assert np.linalg.norm(field, axis=1) == pytest.approx(0.48)


def test_specific_force_without_noise_integrates_to_the_velocity() -> None:
    test = test_of(sensors=QUIET, mission=WEAVE, criterion="state")
    parts = score_compiled(test, Evaluator(test).space.fixed, 1, in_parts=True).parts
    assert parts["state_rmse"]["u_mps"] < 0.01
    assert parts["state_rmse"]["north_m"] < 0.1


@pytest.mark.parametrize("name", ["inverse-model", "mahony", "ekf"])
@pytest.mark.parametrize("vehicle", ["aerosonde-2012", "iris"])
def test_the_error_is_that_of_the_flight_through_the_proxy(name: str, vehicle: str) -> None:
    broken = FaultRange(fault="bias", target="HIL_SENSOR.xgyro", value=0.1, at_s=2.0, for_s=2.0)
    test = test_of(
        vehicle=vehicle, estimator=name, mission=Mission(roll_deg=15.0), faults=[broken],
        initial=InitialState(height_m=60.0), duration_s=6.0,
    )  # fmt: skip
    values = Evaluator(test).space.fixed
    own = score_compiled(test, values, 5)
    proxied = score_flight(test, document_of(test, values, 5))
    assert own.rmse_deg == pytest.approx(proxied.rmse_deg, rel=0.02, abs=0.01)


def test_a_flight_that_leaves_the_envelope_scores_by_how_long_it_lasted() -> None:
    test = test_of(controls=SearchControls(elevator_deg=(-25.0, -4.0)), duration_s=20.0)
    outcome = Evaluator(test).evaluate(np.array([[0.0], [0.5], [1.0]]), 1, 0)
    assert (outcome.broken_limit[:2] > 0).all()
    assert outcome.fitness[0] < outcome.fitness[1] < 0.0
    assert LIMITS[outcome.broken_limit[0]] in ("alpha", "load", "pitch", "rate")


def test_an_evaluation_is_the_same_alone_and_among_others() -> None:
    test = test_of(initial=InitialState(roll_deg=(-20.0, 20.0)), noise_draws=2, duration_s=2.0)
    points = np.linspace(0.1, 0.9, 6)[:, None]
    together = Evaluator(test).evaluate(points, seed=5, first=100).fitness
    alone = [Evaluator(test).evaluate(points[i : i + 1], 5, 100 + i).fitness[0] for i in (0, 5)]
    assert together[[0, 5]].tolist() == alone


def test_an_estimator_in_python_is_searched_too() -> None:
    test = test_of(estimator="madgwick", mission=WEAVE, criterion="angle", duration_s=3.0)
    outcome = Evaluator(test).evaluate(np.zeros((1, 0)), seed=1, first=0)
    assert 0.0 < outcome.fitness[0] < 30.0


def test_an_unknown_estimator_is_the_users_error() -> None:
    with pytest.raises(ConfigError, match="known: complementary"):
        Evaluator(test_of(estimator="guess")).evaluate(np.zeros((1, 0)), 1, 0)


def test_twelve_states_are_scored_in_their_scales() -> None:
    test = test_of(mission=WEAVE, criterion="state")
    scores = score_compiled(test, Evaluator(test).space.fixed, 1, in_parts=True)
    scales = np.repeat([10.0, 1.0, 1.0, 1.0], 3)
    rmse = np.array(list(scores.parts["state_rmse"].values()))
    assert scores.error == pytest.approx(np.sqrt(((rmse / scales) ** 2).mean()))


def test_a_case_is_broken_down_by_phase_and_by_fault() -> None:
    broken = FaultRange(fault="bias", target="HIL_SENSOR.xgyro", value=0.1, at_s=4.0, for_s=2.0)
    test = test_of(mission=WEAVE, faults=[broken])
    parts = score_compiled(test, Evaluator(test).space.fixed, 1, in_parts=True).parts
    assert set(parts["phases"]) >= {"turn"}
    assert sum(p["samples"] for p in parts["phases"].values()) == parts["samples"] == 1000
    assert parts["faults"]["drawn-0"]["samples"] == 200
    assert parts["faults"]["drawn-0"]["max_deg"]["roll"] == pytest.approx(11.4, abs=1.0)
    assert parts["angle_percentiles_deg"]["50"] <= parts["angle_percentiles_deg"]["99"]
