import csv
import json
import os
import shlex
import shutil
import textwrap
from itertools import takewhile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pyarrow.parquet as pq
import pytest

from analysis.autopilots.flight_process import RUN_FOLDER
from analysis.campaign.campaign_file import CampaignFile, read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.flying.flight_job import setup_by_name
from analysis.campaign.results.campaign_page import rerun_command
from analysis.campaign.results.campaign_report import name_tests
from analysis.campaign.results.data_set import export_data_set
from analysis.campaign.results.outcome_grid import severity_key
from analysis.campaign.results_store import read_campaign_folder
from analysis.flying.flight_evidence import CellVerdict, monitor_verdict
from analysis.results import read_results
from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.space.test_file import read_test
from mavproxy_fault import cli
from mavproxy_fault.documents.errors import ConfigError

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def campaign_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the small campaign, with its data set beside it."""
    folder = tmp_path_factory.mktemp("campaign")
    arguments = ["--out", str(folder / "out"), "--dataset", str(folder / "data"), "--workers", "1"]
    # The larger magnitude fails.
    assert cli.main(["campaign", str(HERE / "small.yaml"), *arguments]) == 1
    return folder


def outcomes(folder: Path) -> dict[tuple[str, str], str]:
    with (folder / "cells.csv").open() as file:
        return {(r["subject"], r["magnitude"]): r["outcome"] for r in csv.DictReader(file)}


def test_a_small_fault_is_harmless_and_a_large_one_is_not(campaign_folder: Path) -> None:
    found = outcomes(campaign_folder / "out")
    assert found["ekf", "0.001"] == found["mahony", "0.001"] == "unaffected"
    assert found["ekf", "2.0"] in ("degraded", "lost")
    summary = json.loads((campaign_folder / "out" / "campaign-summary.json").read_text())
    assert summary["cells"] == 4


def test_results_have_the_monitors_verdict(campaign_folder: Path) -> None:
    with (campaign_folder / "out" / "cells.csv").open() as file:
        rows = {(row["subject"], row["magnitude"]): row for row in csv.DictReader(file)}
    # One flight, one monitor: the verdict does not depend on the estimator under test.
    small, large = rows["ekf", "0.001"], rows["ekf", "2.0"]
    assert (small["verdict"], small["blamed"], small["verdict_s"]) == ("missed", "", "")
    assert large["verdict"] in ("isolated", "wrong", "ambiguous", "detected")
    assert large["blamed"]
    for name in ("verdict", "blamed", "verdict_s"):
        assert large[name] == rows["mahony", "2.0"][name]


def test_the_first_detected_part_of_a_preset_counts() -> None:
    missed = {"verdict": "missed", "isolated": [], "wrongly": [], "delay_s": None}
    late = {"verdict": "isolated", "isolated": ["baro"], "wrongly": [], "delay_s": 2.0}
    blame = {"who": "GPS", "from_s": 1.0, "for_s": 1.0}
    soon = {"verdict": "wrong", "isolated": ["imu"], "wrongly": [blame, blame], "delay_s": 0.5}
    assert monitor_verdict([missed, late, soon]) == CellVerdict("wrong", "imu, GPS", 0.5)
    assert monitor_verdict([missed]) == CellVerdict("missed", "", None)
    assert monitor_verdict([]) == CellVerdict()


def test_each_cell_is_a_test_case(campaign_folder: Path) -> None:
    suite = ElementTree.parse(campaign_folder / "out" / "junit.xml").getroot()
    assert suite.get("tests") == "4"
    failed = [case for case in suite if case.find("failure") is not None]
    assert {(case.get("classname"), case.get("name")) for case in failed} == {
        (f"small.{subject}", "gyro 2 rad/s, from 2 s for 2 s, short.yaml, seed 1")
        for subject in ("ekf", "mahony")
    }


def test_the_page_is_self_contained_and_has_the_curves(campaign_folder: Path) -> None:
    text = (campaign_folder / "out" / "campaign.html").read_text()
    assert "http://" not in text.split("<!-- uPlot")[0].replace("http://www.w3.org", "")
    model = json.loads(text.split('id="model">')[1].split("</script>")[0])
    assert len(model["curves"]) == 4
    assert "ekf|short.yaml|1" in model["twins"]


def test_the_page_shows_the_most_harmful_faults(campaign_folder: Path) -> None:
    text = (campaign_folder / "out" / "campaign.html").read_text()
    rows = text.split('aria-label="Pareto"')[1].split("</table>")[0]
    rows = rows.replace(' class="number"', "")
    # Both estimators are degraded by the larger of the two magnitudes.
    assert "<td>ekf</td><td>gyro</td><td>1</td><td>50</td><td>50</td>" in rows
    assert "<td>mahony</td><td>gyro</td><td>1</td><td>50</td><td>100</td>" in rows


def test_a_completed_campaign_flies_nothing(campaign_folder: Path, capsys) -> None:
    before = (campaign_folder / "out" / "cells.jsonl").read_bytes()
    arguments = ["--out", str(campaign_folder / "out"), "--workers", "1"]
    assert cli.main(["campaign", str(HERE / "small.yaml"), *arguments]) == 1
    assert (campaign_folder / "out" / "cells.jsonl").read_bytes() == before
    assert "4 cells, 0 aborted, 2 failed (degraded or worse)" in capsys.readouterr().out


def test_a_killed_campaign_repeats_only_unfinished_flights(
    campaign_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(campaign_folder / "out", out)
    lines = (out / "cells.jsonl").read_bytes().splitlines(keepends=True)
    (out / "cells.jsonl").write_bytes(b"".join(lines[:2]) + lines[2][:30])
    arguments = ["--out", str(out), "--workers", "1"]
    assert cli.main(["campaign", str(HERE / "small.yaml"), *arguments]) == 1
    again = (out / "cells.jsonl").read_bytes().splitlines(keepends=True)
    assert again[:2] == lines[:2], "the first flight was not made again"
    assert len(again) == 4
    assert outcomes(out) == outcomes(campaign_folder / "out")


def test_another_campaigns_folder_is_refused(campaign_folder: Path, tmp_path: Path, capsys) -> None:
    changed = (HERE / "small.yaml").read_text().replace("2.0", "3.0")
    (tmp_path / "changed.yaml").write_text(changed)
    shutil.copy(HERE / "short.yaml", tmp_path)
    assert (
        cli.main(
            ["campaign", str(tmp_path / "changed.yaml"), "--out", str(campaign_folder / "out")]
        )
        == 2
    )
    assert "contains another campaign" in capsys.readouterr().err


def test_the_data_set_has_sensors_before_and_after_the_faults_truth_and_labels(
    campaign_folder: Path,
) -> None:
    cells = pq.read_table(campaign_folder / "data" / "cells.parquet").to_pylist()
    assert len(cells) == 4
    worst = next(cell for cell in cells if cell["magnitude"] == 2.0 and cell["subject"] == "mahony")
    flight = campaign_folder / "data" / "flights" / worst["flight"]
    before, after = (
        pq.read_table(flight / f"HIL_SENSOR.{side}.parquet")["xgyro"].to_numpy()
        for side in ("received", "sent")
    )
    assert (after - before).max() == pytest.approx(2.0, abs=1e-5)
    (label,) = pq.read_table(flight / "labels.parquet").to_pylist()
    assert label["frames"] == (after != before).sum() == 200
    assert (flight / "HIL_STATE_QUATERNION.sent.parquet").is_file()
    assert "gyro" in (campaign_folder / "data" / "README.md").read_text()


def test_an_autopilots_run_is_exported_like_a_simulated_flight(
    campaign_folder: Path, tmp_path: Path
) -> None:
    campaign = tmp_path / "out"
    shutil.copytree(campaign_folder / "out", campaign)
    for flight in (campaign / "flights").iterdir():
        flight.rename(campaign / "moved")
        flight.mkdir()
        (campaign / "moved").rename(flight / RUN_FOLDER)
    export_data_set(campaign, tmp_path / "data")
    found, expected = (
        {str(file.relative_to(data)) for file in data.rglob("*")}
        for data in (tmp_path / "data", campaign_folder / "data")
    )
    assert found == expected
    cells, expected_cells = (
        pq.read_table(data / "cells.parquet")
        for data in (tmp_path / "data", campaign_folder / "data")
    )
    assert cells.equals(expected_cells)


def test_the_worst_cell_becomes_a_search_around_it(campaign_folder: Path, capsys) -> None:
    assert cli.main(["campaign", "search", str(campaign_folder / "out")]) == 0
    path = capsys.readouterr().out.split()[-1]
    test = read_test(path)
    assert test.estimator in ("ekf", "mahony")
    (fault,) = test.faults
    assert (fault.fault, fault.target) == ("bias", "HIL_SENSOR.xgyro")
    assert fault.value == (0.6667, 6.0)
    assert (fault.at_s, fault.for_s) == ((0.0, 4.0), (1.0, 4.0))
    # The middle of the search's space is the cell's own flight.
    assert test.scenario is not None
    assert Evaluator(test).space.names == (
        "faults[0].value",
        "faults[0].at_s",
        "faults[0].for_s",
    )


def test_a_search_around_a_named_cell_is_written(campaign_folder: Path, capsys) -> None:
    key = "ekf|short.yaml|gyro|2.0|2|1|0.001"
    assert cli.main(["campaign", "search", str(campaign_folder / "out"), key]) == 0
    assert read_test(capsys.readouterr().out.split()[-1]).faults[0].value == (0.0003333, 0.003)
    assert cli.main(["campaign", "search", str(campaign_folder / "out"), "ekf|nothing"]) == 2
    assert "not a cell of" in capsys.readouterr().err
    name = "gyro 0.001 rad/s, from 2 s for 2 s, short.yaml, seed 1"
    assert cli.main(["campaign", "search", str(campaign_folder / "out"), name]) == 0
    assert read_test(capsys.readouterr().out.split()[-1]).faults[0].value == (0.0003333, 0.003)


def test_wind_and_start_can_be_dimensions(tmp_path: Path) -> None:
    shutil.copy(HERE / "short.yaml", tmp_path)
    vary = '{"environment.wind_ned_mps[0]": [0, 5], start.heading_deg: [90]}'
    (tmp_path / "c.yaml").write_text((HERE / "small.yaml").read_text() + f"\nvary: {vary}\n")
    campaign = read_campaign(tmp_path / "c.yaml")
    plan = CampaignPlan(campaign)
    assert plan.max_cells == 8
    name = "short.yaml environment.wind_ned_mps[0]=5 start.heading_deg=90"
    assert plan.scenarios[1] == name
    scenario = setup_by_name(campaign, name).scenario
    assert scenario.environment.wind_ned_mps[0] == 5.0
    assert scenario.start.heading_deg == 90.0
    arguments = ["--set", "environment.wind_ned_mps[0]=5", "--set", "start.heading_deg=90"]
    assert campaign.scenario_arguments(name) == [str(tmp_path / "short.yaml"), *arguments]


def test_the_size_is_printed_before_the_first_flight(tmp_path: Path, capsys) -> None:
    arguments = ["--dry-run", "--workers", "2", "--out", str(tmp_path / "none")]
    assert cli.main(["campaign", str(HERE / "small.yaml"), *arguments]) == 0
    assert "small: 4 cells in 3 flights of 6 s" in capsys.readouterr().out
    assert not (tmp_path / "none").exists()


def put_px4(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a build of PX4 has of that for which the command looks."""
    for file in ("bin/px4", "etc/init.d-posix/rcS"):
        (folder / file).parent.mkdir(parents=True)
        (folder / file).touch(0o755)
    monkeypatch.setenv("PATH", f"{folder / 'bin'}:{os.environ['PATH']}")


def test_the_estimated_duration_accounts_for_autopilots(tmp_path, monkeypatch, capsys) -> None:
    put_px4(tmp_path, monkeypatch)
    file = HERE.parents[2] / "examples" / "campaign_px4.yaml"
    assert cli.main(["campaign", str(file), "--dry-run", "--workers", "2"]) == 0
    assert capsys.readouterr().out.endswith(
        "60 cells in 61 flights of 26 s, about 13 min on 2 free processors\n"
    )


@pytest.mark.parametrize("binary", ["no-such-px4", "/bin/true", "''"])
def test_a_missing_binary_is_found_before_the_first_flight(tmp_path, binary: str, capsys) -> None:
    shutil.copy(HERE / "short.yaml", tmp_path)
    (tmp_path / "c.yaml").write_text(
        (HERE / "small.yaml")
        .read_text()
        .replace("[ekf, mahony]", f"[ekf, {{name: mine, autopilot: px4, binary: {binary}}}]")
    )
    for more in (["--dry-run"], []):
        arguments = ["campaign", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out"), *more]
        assert cli.main(arguments) == 2
        assert "subject mine: binary" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("count", ["-3", "0", "1.5", "many", ""])
def test_a_wrong_number_of_workers_is_refused(count: str, capsys) -> None:
    for command in ("campaign", "search"):
        with pytest.raises(SystemExit) as exit:
            cli.main([command, str(HERE / "small.yaml"), "--workers", count])
        assert exit.value.code == 2
        assert "is no whole number of 1 or more" in capsys.readouterr().err


def campaign_of(folder: Path, **keys: object) -> CampaignFile:
    shutil.copy(HERE / "short.yaml", folder)
    (folder / "c.yaml").write_text(json.dumps(
        {"subjects": ["ekf"], "scenarios": ["short.yaml"], "onsets": [2], "durations_s": [1],
         "faults": [{"fault": "bias", "target": "HIL_SENSOR.xgyro", "magnitudes": [1e-4, 0.5]}],
         **keys}
    ))  # fmt: skip
    return read_campaign(folder / "c.yaml")


def test_cells_fail_from_the_outcome_that_the_file_names(tmp_path: Path) -> None:
    cell = Cell(subject="ekf", scenario="s", fault="f")

    def fails(campaign, outcome, failed=""):
        return campaign.fails(CellResult(cell=cell, outcome=outcome, failed=failed))

    default = campaign_of(tmp_path)
    assert fails(default, "unaffected", "impact, m/s 2 (limit 1)")
    assert [fails(default, name) for name in ("detected", "degraded", "lost")] == [
        False,
        True,
        True,
    ]
    late = campaign_of(tmp_path, limits={"worse_from": "detected", "fail_from": "lost"})
    assert [fails(late, name) for name in ("degraded", "landed", "crashed")] == [False, False, True]
    # A bisection looks for bad outcomes.
    critical = campaign_of(tmp_path, find="critical")
    assert not fails(critical, "crashed")
    assert fails(campaign_of(tmp_path, find="critical", limits={"fail_from": "lost"}), "crashed")
    # No vehicle has passed where nothing flew.
    assert all(fails(campaign, "aborted") for campaign in (default, late, critical))
    with pytest.raises(ConfigError, match="fail_from = bad is unknown"):
        campaign_of(tmp_path, limits={"fail_from": "bad"})


def test_a_campaign_without_failing_cells_exits_0(tmp_path: Path, capsys) -> None:
    campaign_of(tmp_path, limits={"fail_from": "crashed"})
    out = tmp_path / "out"
    assert _main("campaign", str(tmp_path / "c.yaml"), "--out", str(out), "--workers", "1") == 0
    text = capsys.readouterr().out
    assert "degraded" in text
    assert "2 cells, 0 aborted, 0 failed (crashed or worse)" in text
    assert ElementTree.parse(out / "junit.xml").getroot().get("failures") == "0"


def test_aborted_cells_fail_the_campaign(tmp_path: Path) -> None:
    # The flight has no landing.
    campaign_of(tmp_path, onsets=["landing"], limits={"fail_from": "crashed"})
    arguments = ["--out", str(tmp_path / "out"), "--workers", "1"]
    assert _main("campaign", str(tmp_path / "c.yaml"), *arguments) == 1


def test_names_of_tests_differ_even_for_close_magnitudes(tmp_path: Path) -> None:
    campaign = campaign_of(tmp_path)
    results = [
        CellResult(
            cell=Cell(
                subject="ekf", scenario="short.yaml", fault=campaign.faults[0].name, magnitude=size
            ),
            outcome="unaffected",
        )
        for size in (0.100001, 0.100002, 0.2)
    ]
    assert len(set(name_tests(campaign, results))) == 3


def test_the_command_of_a_cell_flies_its_estimator_again(
    campaign_folder: Path, tmp_path: Path, monkeypatch
) -> None:
    campaign, results = read_campaign_folder(campaign_folder / "out")
    result = max((r for r in results if r.cell.subject == "mahony"), key=severity_key)
    write, _, run = rerun_command(result, campaign).partition(" && ")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.yaml").write_text(shlex.split(write)[1])
    arguments = [*shlex.split(run)[1:-1], "--out", "again", "--zenoh", "off", "--no-report"]
    assert shlex.split(run)[-1] == "--ui"
    cli.main(arguments)
    errors = [r for r in read_results(tmp_path / "again/results.jsonl") if hasattr(r, "estimator")]
    angles = [error.angle for error in errors if error.estimator == "mahony"]
    assert {error.estimator for error in errors} == {"mahony"}
    # The excursion is the error beyond that of the reference flight, which is a few degrees.
    assert max(angles) == pytest.approx(result.excursion_deg, abs=5.0)


def test_the_documented_snippet_reads_the_data_set(campaign_folder: Path, monkeypatch) -> None:
    text = (HERE.parents[2] / "docs" / "campaigns.md").read_text()
    lines = text[text.index("    import pyarrow.parquet as pq") :].splitlines()
    snippet = textwrap.dedent("\n".join(takewhile(lambda line: line.startswith("    "), lines)))
    monkeypatch.chdir(campaign_folder)
    found: dict[str, Any] = {}
    exec(snippet, found)
    assert found["label"]["frames"] == found["faulty"].sum() == 200


def test_wrong_arguments_are_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="two campaign folders"):
        _main("campaign", "compare", str(tmp_path))
    with pytest.raises(ConfigError, match="contains no campaign"):
        _main("campaign", "compare", str(tmp_path), str(tmp_path))


def _main(*arguments: str) -> int:
    args = cli.build_parser("").parse_args(arguments)
    return int(args.main(args))
