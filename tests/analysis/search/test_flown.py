"""Flights through the proxy: scenarios of any kind, and cases as files."""

import msgspec
import numpy as np
import pytest
import yaml

from analysis.campaign.campaign_file import read_campaign
from analysis.flying.internal_flight import run_simulated_flight
from analysis.flying.onset import onset_keys
from analysis.flying.worker_pool import WorkerPool
from analysis.run.run_setup import read_setup
from analysis.scoring.attitude_scoring import AttitudeConfig
from analysis.search.cases import write_cases
from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.search_command import run_search
from analysis.search.space.point_scenario import document_of
from analysis.search.space.test_file import (
    FaultRange,
    InitialState,
    Mission,
    SearchControls,
    TestFile,
    read_test,
)
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import parse_schedule

BIAS = FaultRange(fault="bias", target="HIL_SENSOR.xgyro", value=0.02, at_s=3.0, for_s=3.0)
SCENARIO = """
name: quad
duration_s: 4
start: {height_m: 30}
vehicle: {kind: multirotor, parameters: iris}
mission: [{shape: line, size_m: 100, height_m: 30, speed_mps: 3}]
sensors: {imu: {preset: consumer-mems, rate_hz: 100}, mag: {rate_hz: 25}, gps: {rate_hz: 5}}
"""
SEARCH = """
scenario: quad.yaml
vary: {"environment.wind_ned_mps[0]": [-4, 4], start.heading_deg: [0, 90]}
estimator: mahony
budget: 3
rescore_draws: 1
keep: 1
faults:
  - {fault: saturate, target: HIL_SENSOR.xgyro, also: {low: -0.1, high: 0.1}, at_s: [0, 2]}
"""


def test_a_worst_case_is_a_scenario_that_run_flies_to_the_same_error(tmp_path):
    test = TestFile(
        duration_s=5.0,
        noise_draws=2,
        rescore_draws=16,
        keep=1,
        budget=64,
        initial=InitialState(height_m=1000.0, roll_deg=(-40.0, 40.0)),
        controls=SearchControls(aileron_deg=(-1.0, 1.0)),
        faults=[msgspec.structs.replace(BIAS, value=(-0.02, 0.02), at_s=(0.5, 2.0))],
    )
    cases, _ = run_search(test, WorkerPool(), tmp_path)
    paths = write_cases(tmp_path, test, cases)
    assert [path.name for path in paths] == [
        "worst-01.yaml",
        "worst-01-test.yaml",
        "worst-01-campaign.yaml",
        "worst-01-shrunk.yaml",
        "worst-01-shrunk-test.yaml",
        "worst-01-shrunk-campaign.yaml",
    ]
    for path, error in ((paths[0], cases[0].error_deg), (paths[3], cases[0].shrunk_deg)):
        setup = read_setup(str(path))
        again = run_simulated_flight(setup, []).attitude["inverse-model"]["rmse_deg"]["max"]
        assert again == pytest.approx(error, rel=0.05, abs=5.0 * 0.02)


def test_a_scenario_of_any_kind_is_searched_with_any_fault(tmp_path):
    (tmp_path / "quad.yaml").write_text(SCENARIO)
    (tmp_path / "search.yaml").write_text(SEARCH)
    test = read_test(tmp_path / "search.yaml")
    assert Evaluator(test).space.names == (
        "vary.environment.wind_ned_mps[0]",
        "vary.start.heading_deg",
        "faults[0].at_s",
    )
    cases, totals = run_search(test, WorkerPool(), tmp_path / "out")
    assert totals.tests == 3
    assert cases[0].error_deg > 0.0
    path = write_cases(tmp_path, test, cases)[0]
    written = yaml.safe_load(path.read_text())
    heading = cases[0].values["vary.start.heading_deg"]
    assert written["start"]["heading_deg"] == heading
    setup = read_setup(str(path))
    assert setup.scenario.vehicle.kind == "multirotor"
    assert setup.monitor.attitude == AttitudeConfig(estimators=("mahony",))
    rmse = run_simulated_flight(setup, []).attitude["mahony"]["rmse_deg"]
    assert rmse["max"] == pytest.approx(cases[0].parts["rmse_deg"]["max"], rel=1e-9)


def test_a_worst_case_is_a_test_cell_of_a_campaign(tmp_path):
    (tmp_path / "quad.yaml").write_text(SCENARIO)
    (tmp_path / "search.yaml").write_text(SEARCH)
    cases, _ = run_search(read_test(tmp_path / "search.yaml"), WorkerPool(), tmp_path / "out")
    write_cases(tmp_path, read_test(tmp_path / "search.yaml"), cases)
    cell = read_campaign(tmp_path / "worst-01-campaign.yaml")
    setup = read_setup(str(tmp_path / "worst-01.yaml"))
    (entry,) = [parsed for parsed in setup.schedule.faults if parsed.id == "drawn-0"]
    (choice,) = cell.faults
    (again,) = choice.entries(
        choice.magnitude_list()[0], onset_keys(cell.onsets[0]), cell.durations_s[0]
    )
    assert again.pop("for_s") == setup.scenario.duration_s  # the search's lasts to the end
    assert parse_schedule({"faults": [again]}, "here").faults[0] == entry
    assert cell.seeds == (setup.scenario.seed,)
    assert cell.subject_names == ["mahony"]


def test_a_key_that_the_scenario_does_not_have_is_the_users_error(tmp_path):
    (tmp_path / "quad.yaml").write_text(SCENARIO)
    (tmp_path / "search.yaml").write_text("scenario: quad.yaml\nvary: {start.heigt_m: [1, 2]}\n")
    with pytest.raises(
        ConfigError, match=r"vary.start.heigt_m: heigt_m is unknown; known: lat_deg"
    ):
        Evaluator(read_test(tmp_path / "search.yaml")).evaluate(np.zeros((1, 1)), 1, 0)


def test_the_projects_own_fusion_is_searched():
    test = TestFile(
        estimator="fusion",
        criterion="angle",
        duration_s=4.0,
        noise_draws=1,
        initial=InitialState(height_m=1000.0),
        mission=Mission(),
        faults=[BIAS],
    )
    outcome = Evaluator(test).evaluate(np.zeros((1, 0)), 1, 0)
    assert outcome.broken_limit[0] == 0
    assert 0.0 < outcome.fitness[0] < 10.0


def test_a_fault_that_lasts_no_time_is_left_out_of_the_scenario():
    test = TestFile(duration_s=5.0, faults=[BIAS], initial=InitialState(height_m=500.0))
    values = dict(Evaluator(test).space.fixed)
    assert len(document_of(test, values, 1)["schedule"]["faults"]) == 1
    values["faults[0].for_s"] = 0.0
    assert document_of(test, values, 1)["schedule"]["faults"] == []
