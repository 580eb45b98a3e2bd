from pathlib import Path

import pytest
import yaml

import mavproxy_fault

ROOT = Path(__file__).parents[3]
SHORT = {
    "duration_s": 6,
    "start": {"height_m": 30},
    "vehicle": {"kind": "multirotor", "parameters": "iris"},
    "mission": [{"shape": "s", "size_m": 60, "height_m": 30, "speed_mps": 4, "laps": 3}],
}
HOVER = ROOT / "examples" / "px4_brief_hover.yaml"
BIAS = {"fault": "bias", "target": "HIL_SENSOR.xgyro"}


def test_a_run_takes_settings_and_estimators_and_its_log_a_report(tmp_path: Path) -> None:
    run = mavproxy_fault.run(
        SHORT,
        set={"environment.wind_ned_mps[0]": 6.5, "duration_s": 5},
        estimators=["mahony", "madgwick"],
        out=tmp_path / "run",
    )
    assert run.summary["sim_s"] == pytest.approx(5, abs=0.1)
    estimators = run.results["AttitudeError"]["estimator"]
    assert set(estimators) == {"mahony", "madgwick"}
    report = mavproxy_fault.report(run.folder / "sent.tlog", out=tmp_path / "report")
    assert report.verdict == report.summary["verdict"]
    assert report.page.is_file()


def test_an_autopilot_that_cannot_fly_is_no_flight_of_the_simulators_controller(
    flight, tmp_path: Path
) -> None:
    for fly in (mavproxy_fault.run, flight):
        with pytest.raises(mavproxy_fault.ConfigError, match="'no-such-px4' not found"):
            fly(HOVER, autopilot="px4", binary="no-such-px4", out=tmp_path / "none")
    with pytest.raises(mavproxy_fault.ConfigError, match="mahoni is unknown"):
        mavproxy_fault.run(SHORT, estimators=["mahoni"], out=tmp_path / "none")


def test_a_campaign_gives_its_cells_and_whether_it_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # to which file names in a dictionary are relative
    Path("short.yaml").write_text(yaml.safe_dump(SHORT))
    content = {
        "subjects": ["ekf"],
        "scenarios": ["short.yaml"],
        "onsets": [2],
        "durations_s": [2],
        "faults": [{**BIAS, "magnitudes": [0.001, 2.0]}],
    }
    campaign = mavproxy_fault.campaign(content, out=tmp_path / "out", workers=1)
    assert not campaign.passed
    outcomes = dict(zip(campaign.cells["magnitude"], campaign.cells["outcome"], strict=True))
    assert outcomes[0.001] == "unaffected"
    assert outcomes[2.0] in ("degraded", "lost")
    assert campaign.summary["cells"] == 2
    assert list(campaign.frame()["magnitude"]) == list(campaign.cells["magnitude"])
    assert "<td style='color:#2a7'>unaffected</td>" in campaign._repr_html_()
    assert campaign.page.is_file()
    with pytest.raises(mavproxy_fault.ConfigError, match="subjectz"):
        mavproxy_fault.campaign({**content, "subjectz": []}, out=tmp_path / "bad")


def test_a_search_gives_its_worst_cases(tmp_path: Path) -> None:
    content = {
        "duration_s": 10,
        "estimator": "mahony",
        "criterion": "angle",
        "faults": [{**BIAS, "value": [0.0, 0.3], "at_s": 2, "for_s": 4}],
        "keep": 2,
    }
    search = mavproxy_fault.search(content, out=tmp_path / "out", budget=32)
    assert len(search.cases) == 2
    assert search.cases[0]["error_deg"] >= search.cases[1]["error_deg"] > 1.0
    assert list(search.frame()["error_deg"]) == [case["error_deg"] for case in search.cases]
