"""A flight without take-off or fault is repeated, and finally reported as an error."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from analysis.autopilots import flight_process
from analysis.autopilots.flight_process import MAX_TRIES
from analysis.flying import autopilot_cell
from analysis.flying.autopilot_cell import run_autopilot_cell
from analysis.flying.flight_evidence import CellVerdict, Evidence
from analysis.scoring.criteria import FailsafeCriterion, VehicleCriteria
from analysis.scoring.vehicle_outcome import VehicleEvent, VehicleOutcome
from mavproxy_fault.documents.errors import ConfigError

FAULT = {
    "verdict": "isolated", "isolated": ["imu"], "wrongly": [], "delay_s": 0.5, "start_s": 20.0
}  # fmt: skip
OUTCOME = VehicleOutcome(
    outcome="failsafe", source="truth", impact_mps=0.5, excursion_m=12.0, failsafe="LAND",
    events=[VehicleEvent(22.0, "failsafe", "LAND: EKF Failsafe")],
)  # fmt: skip
LIMITS = VehicleCriteria(failsafe=FailsafeCriterion(mode="LAND", within_s=3.0))
ONE: dict[str, Any] = {"seed": 1, "faults": [{"id": "gyro"}]}
NONE: dict[str, Any] = {"seed": 1, "faults": []}


def flights(monkeypatch: pytest.MonkeyPatch, summaries: list[tuple[bool, bool]]) -> list[int]:
    """Let flights end with summaries of (took off, fault acted), and count them."""
    tries: list[int] = []

    def fly(subject: str, run: Any, schedule: Any, folder: Path, *, kept: bool) -> Path:
        took_off, acted = summaries[len(tries)]
        tries.append(len(tries))
        moments = {"take-off": 12.0} if took_off else {}
        autopilot = {"moments_s": moments, "ended_early": "" if took_off else "gave up"}
        (folder / "run").mkdir()
        summary = {
            "autopilot": autopilot, "faults": [FAULT] if acted else [],
            "outcome": msgspec.to_builtins(OUTCOME),
        }  # fmt: skip
        (folder / "run" / "summary.json").write_text(json.dumps(summary))
        return folder / "run"

    monkeypatch.setattr(flight_process, "run_flight_process", fly)
    monkeypatch.setattr(autopilot_cell, "collect_evidence", lambda _: (Evidence(), 20.0))
    return tries


def test_a_flight_whose_fault_never_acted_is_repeated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    tries = flights(monkeypatch, [(False, False), (True, False), (True, True)])
    found = run_autopilot_cell("px4", [], ONE, tmp_path, LIMITS, kept=True)
    assert len(tries) == 3
    assert (found.verdict, found.failed) == (CellVerdict("isolated", "imu", 0.5), "")


def test_a_flight_is_held_against_the_campaign_s_criteria_on_the_vehicle(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    flights(monkeypatch, [(True, True)])
    limits = VehicleCriteria(outcome="at most degraded", excursion_m=5.0, impact_mps=1.0)
    found = run_autopilot_cell("px4", [], ONE, tmp_path, limits, kept=True)
    assert found.failed == (
        "vehicle outcome failsafe (limit at most degraded), excursion, m 12.0 (limit 5.0)"
    )


def test_a_reference_flight_without_take_off_is_repeated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    tries = flights(monkeypatch, [(False, False), (True, False)])
    assert run_autopilot_cell("px4", [], NONE, tmp_path, LIMITS, kept=True).verdict == CellVerdict()
    assert len(tries) == 2


@pytest.mark.parametrize(
    ("took_off", "error"),
    [
        (True, "px4: the fault never acted in 3 tries"),
        (False, "the vehicle did not take off in 3 tries"),
    ],
)
def test_without_a_valid_flight_there_is_no_outcome(
    took_off: bool, error: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    flights(monkeypatch, [(took_off, False)] * MAX_TRIES)
    with pytest.raises(ConfigError, match=error):
        run_autopilot_cell("px4", [], ONE, tmp_path, LIMITS, kept=True)
