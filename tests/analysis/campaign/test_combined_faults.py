"""Campaigns with requirements, several faults at once, and onsets at conditions."""

import json
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
import yaml

from analysis.campaign.campaign_file import CampaignFile, read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.results.outcome_grid import find_interactions
from analysis.flying.onset import onset_keys
from mavproxy_fault import cli
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import parse_schedule

HERE = Path(__file__).parent
GYRO = {"id": "gyro", "fault": "bias", "target": "HIL_SENSOR.xgyro", "magnitudes": [1e-4, 0.5]}
MAG = {"id": "mag", "fault": "bias", "target": "HIL_SENSOR.xmag", "magnitudes": [0.1]}
BOTH = {"id": "both", "faults": [{k: f[k] for k in ("fault", "target")} for f in (GYRO, MAG)],
        "magnitudes": [0.2]}  # fmt: skip


def campaign_of(folder: Path, faults: list[dict[str, Any]], **keys: Any) -> CampaignFile:
    (folder / "short.yaml").write_bytes((HERE / "short.yaml").read_bytes())
    document = {"name": "c", "subjects": ["ekf"], "scenarios": ["short.yaml"], "onsets": [2],
                "durations_s": [1], "faults": faults, **keys}  # fmt: skip
    (folder / "c.yaml").write_text(yaml.safe_dump(document))
    return read_campaign(folder / "c.yaml")


def test_a_fault_of_several_parts_gives_its_magnitude_to_each(tmp_path: Path) -> None:
    both = campaign_of(tmp_path, [BOTH]).all_faults["both"]
    entries = both.entries(0.2, {"at_s": 3.0}, 5.0)
    assert [(e["target"], e["value"], e["at_s"]) for e in entries] == [
        ("HIL_SENSOR.xgyro", 0.2, 3.0), ("HIL_SENSOR.xmag", 0.2, 3.0),
    ]  # fmt: skip
    assert len(parse_schedule({"faults": entries}, "here").faults) == 2


def test_pairs_are_all_combinations_of_different_faults(tmp_path: Path) -> None:
    campaign = campaign_of(tmp_path, [GYRO, MAG, BOTH], combine=2)
    assert [pair.name for pair in campaign.pairs] == [
        "gyro 0.0001 + mag 0.1", "gyro 0.0001 + both 0.2", "gyro 0.5 + mag 0.1",
        "gyro 0.5 + both 0.2", "mag 0.1 + both 0.2",
    ]  # fmt: skip
    plan = CampaignPlan(campaign)
    assert plan.max_cells == 4 + 5
    with pytest.raises(ConfigError, match="combine needs find: outcomes"):
        campaign_of(tmp_path, [GYRO, MAG], combine=2, find="critical")


def test_a_covering_array_has_each_two_values_together_in_fewer_flights(tmp_path: Path) -> None:
    conditions = {"onsets": [1, 2, 3], "durations_s": [0.5, 1], "seeds": [1, 2, 3]}
    campaign = campaign_of(
        tmp_path, [GYRO, MAG, BOTH], combine={"faults": 2, "cover": "pairs"}, **conditions
    )
    plan = CampaignPlan(campaign)
    flown = [cell for cell in plan._series() if " + " in cell.fault]
    assert len(flown) < 5 * 18 / 2
    assert {cell.fault for cell in flown} == {pair.name for pair in campaign.pairs}
    for name, onset in product(("gyro 0.5", "mag 0.1", "both 0.2"), (1.0, 2.0, 3.0)):
        assert any(name in cell.fault and cell.onset == onset for cell in flown)
    together = {(cell.onset, cell.duration_s, cell.seed) for cell in flown}
    assert {t[:2] for t in together} == set(product((1.0, 2.0, 3.0), (0.5, 1.0)))
    assert {t[1:] for t in together} == set(product((0.5, 1.0), (1, 2, 3)))


def test_a_pair_that_fails_alone_is_told_apart_from_one_with_a_failing_part(tmp_path: Path) -> None:
    campaign = campaign_of(tmp_path, [GYRO, MAG], combine=2)

    def result(fault: str, magnitude: float | None, outcome: str) -> CellResult:
        cell = Cell(subject="ekf", scenario="short.yaml", fault=fault, magnitude=magnitude,
                    onset=2.0, duration_s=1.0)  # fmt: skip
        return CellResult(cell=cell, outcome=outcome)

    small, large = "gyro 0.0001 + mag 0.1", "gyro 0.5 + mag 0.1"
    results = [
        result("gyro", 1e-4, "unaffected"), result("gyro", 0.5, "lost"),
        result("mag", 0.1, "detected"), result(small, None, "lost"), result(large, None, "lost"),
    ]  # fmt: skip
    assert [found.cell.fault for found in find_interactions(campaign, results)] == [small]
    fine = msgspec.structs.replace(results[3], outcome="detected")
    assert find_interactions(campaign, [*results[:3], fine]) == []


def test_onsets_are_seconds_phases_events_or_conditions() -> None:
    assert onset_keys(4.0) == {"at_s": 4.0}
    assert onset_keys("climb") == {}
    assert onset_keys("mission-item:2") == {"from": "mission-item:2", "at_s": 0.0}
    assert onset_keys("mode == AUTO.RTL") == {"when": 'mode == "AUTO.RTL"', "at_s": 0.0}
    assert onset_keys("HIL_GPS.alt > 5") == {"when": "HIL_GPS.alt > 5", "at_s": 0.0}
    with pytest.raises(ValueError, match="a flight event"):
        onset_keys("mode = RTL")


def test_a_campaign_judges_its_requirements_at_a_condition(tmp_path: Path, capsys: Any) -> None:
    campaign_of(
        tmp_path, [GYRO], onsets=["count(HIL_GPS) >= 10"], limits={"fail_from": "aborted"},
        requirements={
            "attitude": "always(attitude_error_deg < 5)", "seen": "eventually[0,1](detected)",
        },
    )  # fmt: skip
    out = tmp_path / "out"
    assert (
        cli.main(["campaign", str(tmp_path / "c.yaml"), "--out", str(out), "--workers", "1"]) == 1
    )
    assert "requirement attitude: violated in 1 of 2 cells" in capsys.readouterr().out
    suite = ElementTree.parse(out / "junit.xml").getroot()
    assert suite.get("tests") == "6"
    failed = [case.get("name", "") for case in suite if case.find("failure") is not None]
    assert any(name.startswith("attitude: gyro 0.5") for name in failed)
    assert not any(name.startswith("gyro") for name in failed)  # the outcome fails no cell
    summary = json.loads((out / "campaign-summary.json").read_text())
    assert summary["requirements"]["attitude"]["satisfied"] == 1
    results = [json.loads(line) for line in (out / "cells.jsonl").read_text().splitlines()]
    assert all(1.5 < result["onset_s"] < 3.0 for result in results)
