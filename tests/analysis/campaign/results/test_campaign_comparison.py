from argparse import Namespace
from pathlib import Path

import msgspec
import pytest

from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.results.campaign_comparison import (
    ALL_FAULTS,
    compare_folders,
    compare_pair,
    compare_results,
    holm_correction,
)
from analysis.campaign.results_store import ResultsStore
from mavproxy_fault.documents.errors import ConfigError

TEXT = Namespace(json=False)
SMALL = read_campaign(Path(__file__).parents[1] / "small.yaml")


def result(outcome: str, fault: str = "gyro", seed: int = 1, beyond: float = 1.0) -> CellResult:
    cell = Cell(subject="ekf", scenario="x", fault=fault, magnitude=1.0, seed=seed)
    return CellResult(cell=cell, outcome=outcome, excursion_deg=beyond)


def by_key(results: list[CellResult]) -> dict[str, CellResult]:
    return {r.cell.key: r for r in results}


def test_worse_is_a_worse_outcome_or_a_clearly_larger_excursion() -> None:
    assert compare_pair(result("unaffected"), result("degraded")) == 1
    assert compare_pair(result("lost"), result("degraded")) == -1
    assert compare_pair(result("degraded", beyond=10.0), result("degraded", beyond=11.0)) == 0
    assert compare_pair(result("degraded", beyond=10.0), result("degraded", beyond=13.0)) == 1


def test_a_planted_regression_is_found_and_nothing_else() -> None:
    old = [result("unaffected", fault, seed) for fault in ("gyro", "mag") for seed in range(12)]
    new = [
        result("degraded" if r.cell.fault == "gyro" else "unaffected", r.cell.fault, r.cell.seed)
        for r in old
    ]
    found = {change.fault: change for change in compare_results(by_key(old), by_key(new))}
    assert found["gyro"].regressed
    assert found[ALL_FAULTS].regressed
    assert not found["mag"].regressed
    assert found["gyro"].p_value == pytest.approx(3 * 0.5**12)


def test_a_single_fault_is_one_test_and_not_two() -> None:
    old = [result("detected", seed=seed) for seed in range(11)]
    new = [result("degraded" if s < 9 else "unaffected", seed=s) for s in range(11)]
    (change,) = compare_results(by_key(old), by_key(new))
    assert change.fault == "gyro"
    assert change.p_value == pytest.approx((1 + 11 + 55) * 0.5**11)
    assert change.regressed


def test_equally_many_better_and_worse_cells_are_not_significant() -> None:
    old = [result("degraded", seed=seed) for seed in range(20)]
    new = [result("lost" if s % 2 else "unaffected", seed=s) for s in range(20)]
    assert not any(change.regressed for change in compare_results(by_key(old), by_key(new)))


def test_an_aborted_flight_is_not_compared() -> None:
    found = compare_results(by_key([result("unaffected")]), by_key([result("aborted")]))
    assert found == []


def test_holms_correction_matches_the_paper() -> None:
    assert holm_correction([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_the_exit_code_is_1_if_something_got_worse(tmp_path: Path, capsys) -> None:
    for name, outcome in (("before", "unaffected"), ("after", "lost")):
        ledger = ResultsStore(tmp_path / name, SMALL)
        ledger.add([result(outcome, seed=seed) for seed in range(12)], None)
        ledger.close()
    before, after = tmp_path / "before", tmp_path / "after"
    assert compare_folders(before, after, TEXT) == 1
    assert "unaffected -> lost" in capsys.readouterr().out
    assert compare_folders(after, before, TEXT) == 0
    assert compare_folders(before, before, TEXT) == 0


def test_campaigns_without_a_common_cell_are_refused(tmp_path: Path) -> None:
    other = msgspec.structs.replace(SMALL, name="other")
    for name, campaign in (("a", SMALL), ("b", other)):
        ResultsStore(tmp_path / name, campaign).close()
    with pytest.raises(ConfigError, match="no common cells"):
        compare_folders(tmp_path / "a", tmp_path / "b", TEXT)
