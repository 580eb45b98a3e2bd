"""`search --violate`: a violation is found, reduced, written, and flown again by its command."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml

from analysis.search import counterexample
from analysis.search.space.dimensions import fault_entries
from analysis.search.space.fault_picks import expand_picks, interpolate
from analysis.search.space.point_scenario import faults_of
from analysis.search.space.test_file import read_test
from mavproxy_fault import cli
from mavproxy_fault.documents.errors import ConfigError

SCENARIO = {
    "name": "brief", "duration_s": 5, "start": {"height_m": 20},
    "vehicle": {"kind": "multirotor", "parameters": "iris"},
    "sensors": {"imu": {"preset": "consumer-mems", "rate_hz": 100},
                "mag": {"preset": "consumer-mag", "rate_hz": 25},
                "gps": {"preset": "consumer", "rate_hz": 5}},
    "requirements": {"attitude": "always(attitude_error_deg < 8)"},
}  # fmt: skip
SEARCH = {
    "scenario": "quad.yaml", "estimator": "mahony", "violate": "attitude", "budget": 24, "keep": 1,
    "method": "random", "at_once": [2, 2], "rescore_draws": 2,
    "vary": {"environment.wind_ned_mps[0]": [3, 5]},
    "faults": [
        {"fault": "bias", "any_of": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro"], "value": [1.0, 2.0],
         "at_s": [1, 2], "for_s": [1, 3]},
        {"fault": "bias", "target": "HIL_SENSOR.temperature", "value": [1, 2], "at_s": 1,
         "for_s": 2, "on": ["", "count(HIL_GPS) >= 5"]},
    ],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "quad.yaml").write_text(yaml.safe_dump(SCENARIO))
    (tmp_path / "search.yaml").write_text(yaml.safe_dump(SEARCH))
    return tmp_path


def test_a_counterexample_is_reduced_to_its_cause_and_flies_again(folder: Path, capsys) -> None:
    arguments = ["search", str(folder / "search.yaml"), "--out", str(folder / "out"), "--first"]
    assert cli.main(arguments) == 1
    summary = json.loads((folder / "out" / "search-summary.json").read_text())
    assert summary["flights"] == 8  # the first batch has one, and the rest is not flown
    (found,) = summary["counterexamples"]
    (fault,) = found["faults"]  # the temperature of a sensor has no effect
    assert fault["target"] in ("HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro")
    assert fault["value"] < 1.0 or fault["for_s"] < 1.0
    assert found["failed"] == found["flown"] == 2
    place = folder / "out" / "counterexample-01"
    scenario = yaml.safe_load((place / "scenario.yaml").read_text())
    assert scenario["environment"]["wind_ned_mps"][0] == 0.0  # set back: it is no cause
    page = (place / "report.html").read_text()
    assert "requirement: attitude" in page
    assert "without" in page
    # By its own command, to the last digit.
    program, *words = shlex.split(found["command"])
    assert program == "mavproxy-fault"
    again = folder / "again"
    capsys.readouterr()
    assert cli.main([*words, "--out", str(again), "--zenoh", "off", "--no-report"]) == 1
    (row,) = json.loads((again / "summary.json").read_text())["requirements"]
    assert f"{row['name']}: violated by {-row['robustness']:.3g} deg" in found["violation"]


def test_a_case_that_violates_in_few_of_its_repeated_flights_is_reduced_less(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As at the edge of what an autopilot stands, where its flights differ."""
    flights = counterexample._Flights(read_test(folder / "search.yaml"), 0, {"size": 4.0})
    monkeypatch.setattr(
        flights, "fly", lambda one, n: one["size"] > 1.5 or (one["size"] > 0.5 and n == 0)
    )
    assert [flights.violate({"size": size}) for size in (2.0, 0.5, 1.0)] == [True, False, True]
    assert flights.repeat() == ({"size": 2.0}, 2)  # 1.0 does in one of two


def test_picks_select_fault_target_onset_and_size(folder: Path) -> None:
    test = read_test(folder / "search.yaml")
    shares = dict.fromkeys(fault_entries(test), 0.0)
    shares |= {"picks[1].fault": 0.99, "picks[1].on": 0.9, "picks[0].value": 1.0}
    first, second = faults_of(test, shares)
    assert (first["target"], first["value"], first["at_s"]) == ("HIL_SENSOR.xgyro", 2.0, 1.0)
    assert second["target"] == "HIL_SENSOR.temperature"
    assert second["when"] == "count(HIL_GPS) >= 5"
    assert second["at_s"] == 1.0
    plain, values = expand_picks(test, shares)
    assert plain.at_once is None
    assert values["faults[1].value"] == 1.0


def test_magnitudes_over_decades_are_spaced_logarithmically() -> None:
    assert interpolate((0.01, 1.0), 0.5) == pytest.approx(0.1)
    assert interpolate((-1.0, -0.01), 0.5) == pytest.approx(-0.1)
    assert interpolate((-1.0, 1.0), 0.5) == 0.0
    assert np.isclose(interpolate(3.0, 0.7), 3.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"violate": "attitud"}, "did you mean"),
        ({"at_once": [1, 7]}, "3 at most"),
        ({"scenario": None, "vary": {}, "estimator": "ekf"}, "give scenario too"),
    ],
)
def test_a_wrong_search_is_refused(folder: Path, change: dict, words: str) -> None:
    document = {k: v for k, v in (SEARCH | change).items() if v is not None}
    (folder / "search.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(ConfigError, match=words):
        read_test(folder / "search.yaml")
