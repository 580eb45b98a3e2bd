"""The evidence folder: a table of failure modes whose numbers its own commands make again."""

import csv
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from analysis.campaign.campaign_file import FaultChoice, SubjectChoice, read_campaign
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.results.evidence import (
    describe_fault,
    fmea_row,
    render_page,
    repeatable_part,
)
from analysis.campaign.results.outcome_grid import outcome_grid
from mavproxy_fault import cli

HERE = Path(__file__).parents[1]


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copy(HERE / "short.yaml", tmp_path)
    text = (HERE / "small.yaml").read_text().replace("[ekf, mahony]", "[mahony]")
    text += "requirements: [knows_its_attitude]\nseverity: {lost: hazardous}\n"
    (tmp_path / "small.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_each_row_is_made_again_by_its_command(folder: Path, monkeypatch) -> None:
    arguments = ["--workers", "1", "--out"]
    assert cli.main(["campaign", "small.yaml", "--evidence", "e", *arguments, "c"]) == 1
    mild, severe = rows_of(folder / "e" / "fmea.csv")
    assert severe["failure mode"] == "gyro 2 rad/s"
    assert severe["severity"] == "hazardous"
    assert (mild["severity"], mild["failed"], severe["failed"]) == ("unaffected", "0", "1")
    # One flight without a failure bounds its probability by 1 - 0.025.
    assert (mild["at least"], mild["at most"]) == ("0.0000", "0.9750")
    (required,) = rows_of(folder / "e" / "requirements.csv")
    assert (required["requirement"], required["flights"]) == ("knows_its_attitude", "2")
    assert required["failed"] == "1"
    page = (folder / "e" / "evidence.html").read_text()
    assert severe["sha256"] in page
    monkeypatch.chdir(folder / "e")
    program, *words = shlex.split(severe["command"])
    assert program == "mavproxy-fault"
    assert cli.main([*words, *arguments, "row"]) == 1
    assert rows_of(Path("again") / "fmea.csv") == [severe]


@pytest.mark.browser
def test_nobody_is_kept_from_the_page(
    folder: Path, browser: Any, find_barriers: Callable[[Any], list[str]]
) -> None:
    campaign = read_campaign(folder / "small.yaml")
    result = CellResult(Cell("mahony", "short.yaml", "gyro", 2.0, 2.0, 2.0), "lost")
    (row,) = outcome_grid([result], campaign)
    (folder / "rows").mkdir()
    rows = {"fmea": [fmea_row(campaign, row, row.cells[0], folder)], "requirements": []}
    (folder / "evidence.html").write_text(render_page(campaign, rows), encoding="utf-8")
    page = browser.new_page()
    page.goto((folder / "evidence.html").as_uri())
    assert find_barriers(page) == []
    page.close()


@pytest.mark.parametrize(("subject", "same"), [("px4", True), ("mahony", False)])
def test_only_under_an_autopilot_measured_numbers_may_differ(subject: str, same: bool) -> None:
    px4 = SubjectChoice(name="px4", autopilot="px4", binary="px4")
    campaign = msgspec.structs.replace(read_campaign(HERE / "small.yaml"), subjects=(px4, "mahony"))
    cell = Cell(subject=subject, scenario="short.yaml", fault="gyro")
    one = CellResult(cell=cell, outcome="detected", excursion_m=0.11, detected_s=0.42)
    other = msgspec.structs.replace(one, excursion_m=0.07, detected_s=0.53, wall_s=9.0)
    part = repeatable_part(campaign, one)
    assert (repeatable_part(campaign, other) == part) == same
    for worse in ({"outcome": "crashed"}, {"detected_s": None}, {"failed": "impact"}):
        changed = msgspec.structs.replace(one, **worse)
        assert repeatable_part(campaign, changed) != part


def test_a_fault_is_described_by_its_kind_and_target() -> None:
    fault = FaultChoice(fault="bias", target="HIL_SENSOR.xgyro")
    assert describe_fault(fault).startswith("HIL_SENSOR.xgyro: Add a constant")
    assert describe_fault(FaultChoice(preset="gps-freeze")).startswith("The GPS repeats")


def test_classes_of_unknown_outcomes_are_refused() -> None:
    campaign = read_campaign(HERE / "small.yaml")
    with pytest.raises(ValueError, match=r"severity\.crash is unknown; did you mean crashed"):
        msgspec.structs.replace(campaign, severity={"crash": "catastrophic"}).__post_init__()
