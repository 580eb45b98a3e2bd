"""Scores of subjects with their intervals, the hash of the conditions, and samples of cells."""

from pathlib import Path

import msgspec
import pytest
from scipy.stats import binomtest

from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.results.subject_scores import (
    conditions_hash,
    score_subjects,
    share_bounds,
)

PACKS = Path(__file__).resolve().parents[4] / "benchmarks" / "packs"
PACK = read_campaign(PACKS / "estimators-1.yaml")


@pytest.mark.parametrize(("count", "total"), [(0, 5), (5, 5), (1, 3), (187, 500), (4990, 5000)])
def test_bounds_are_those_of_clopper_and_pearson(count: int, total: int) -> None:
    interval = binomtest(count, total).proportion_ci(0.95, "exact")
    assert share_bounds(count, total) == pytest.approx((interval.low, interval.high), abs=1e-9)


def result(subject: str, outcome: str, verdict: str = "") -> CellResult:
    cell = Cell(subject=subject, scenario="weave", fault="gyro x bias")
    return CellResult(cell=cell, outcome=outcome, verdict=verdict)


def test_aborted_cells_do_not_count_and_the_monitor_scores_by_what_it_isolated() -> None:
    campaign = msgspec.structs.replace(PACK, subjects=("ekf", "monitor"))
    results = [result("ekf", outcome) for outcome in ("unaffected", "degraded", "aborted")]
    verdicts = ("isolated", "wrong", "missed", "not judged")
    results += [result("monitor", "detected", verdict) for verdict in verdicts]
    ekf, monitor = score_subjects(campaign, results)
    assert (ekf.passed, ekf.flown) == (1, 2)
    assert (monitor.passed, monitor.flown) == (1, 3)
    assert ekf.describe().startswith("score    ekf 0.500 (0.013 to 0.987 at 95 %), 1 of 2 cells")


def test_subjects_do_not_change_the_hash_and_conditions_do(tmp_path: Path) -> None:
    other = msgspec.structs.replace(PACK, subjects=("mahony",), name="mine")
    assert conditions_hash(other) == conditions_hash(PACK)
    longer = msgspec.structs.replace(PACK, durations_s=(4.0,))
    assert conditions_hash(longer) != conditions_hash(PACK)
    for name in ("monitor-1.yaml", "monitor_flight.yaml"):
        (tmp_path / name).write_text((PACKS / name).read_text())
    moved = read_campaign(tmp_path / "monitor-1.yaml")
    assert conditions_hash(moved) == conditions_hash(read_campaign(PACKS / "monitor-1.yaml"))
    (tmp_path / "monitor_flight.yaml").write_text("duration_s: 50\n")
    assert conditions_hash(moved) != conditions_hash(read_campaign(PACKS / "monitor-1.yaml"))


# Packs are frozen: a change is a new version.
@pytest.mark.parametrize(
    ("name", "cells", "digest"),
    [
        ("estimators-1", 5000, "3e18e0e4a244"),
        ("autopilots-1", 500, "94fd6d6ab772"),
        ("monitor-1", 500, "90ac2dcc22a9"),
    ],
)
def test_the_packs_are_frozen(name: str, cells: int, digest: str) -> None:
    pack = read_campaign(PACKS / f"{name}.yaml")
    assert CampaignPlan(pack).max_cells == cells * len(pack.subjects)
    assert conditions_hash(pack).startswith(digest)


def test_a_sample_has_the_same_flights_for_each_subject() -> None:
    def cells() -> list[Cell]:
        plan = CampaignPlan(PACK, sample=20)
        assert plan.max_cells == 20 * len(PACK.subjects)
        return [cell for flight in plan._grid() for cell in flight]

    drawn = cells()
    assert drawn == cells()
    conditions = {
        name: [msgspec.structs.replace(c, subject="") for c in drawn if c.subject == name]
        for name in PACK.subject_names
    }
    assert all(listed == conditions["ekf"] for listed in conditions.values())
    assert len({(cell.seed, cell.duration_s) for cell in drawn}) > 5
