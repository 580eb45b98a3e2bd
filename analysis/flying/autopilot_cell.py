"""Fly a cell with a real autopilot: one `mavproxy-fault run --autopilot` and its run folder."""

import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from analysis.autopilots.flight_process import run_flight_process
from analysis.flying.autopilot_evidence import collect_evidence
from analysis.flying.flight_evidence import CampaignFlight, monitor_verdict
from analysis.scoring.criteria import VehicleCriteria, check_vehicle
from analysis.scoring.requirements import RequirementResult
from analysis.scoring.vehicle_outcome import VehicleOutcome
from mavproxy_fault.documents.errors import ConfigError

MAX_TRIES = 3  # on a busy machine the operator's timeouts may end a flight before its fault


def run_autopilot_cell(
    subject: str,
    run: Sequence[str],
    schedule: dict[str, Any],
    folder: Path,
    criteria: VehicleCriteria | None = None,
    *,
    kept: bool,
    must_act: bool = True,
) -> CampaignFlight:
    """Fly a cell and check its criteria; arguments and errors as in `run_flight_process`. Unless
    its fault `must_act`, a flight counts in which the fault's condition never came.

    Raises
    ------
    ConfigError
        If no try had a take-off and a fault that acted.
    """
    started_s = time.monotonic()
    for _ in range(MAX_TRIES):
        run_folder = run_flight_process(subject, run, schedule, folder, kept=kept)
        summary = json.loads((run_folder / "summary.json").read_text())
        took_off = "take-off" in summary["autopilot"]["moments_s"]
        # A flight counts only if it took off and its fault acted.
        if took_off and (summary["faults"] or not (schedule["faults"] and must_act)):
            evidence, flight_s = collect_evidence(run_folder)
            faults, judged = summary["faults"], summary.get("requirements", [])
            begun_s = min((fault["start_s"] for fault in faults), default=None)
            off_ground_s = summary["autopilot"]["moments_s"]["take-off"]
            return CampaignFlight(
                {subject: evidence}, {}, flight_s, time.monotonic() - started_s, str(run_folder),
                monitor_verdict(faults), missed_criteria(criteria, summary) if criteria else "",
                {subject: msgspec.convert(judged, list[RequirementResult])},
                None if begun_s is None else round(begun_s - off_ground_s, 3),
            )  # fmt: skip
        shutil.rmtree(run_folder)
    problem = "the fault never acted" if took_off else "the vehicle did not take off"
    reason = summary["autopilot"]["ended_early"]
    raise ConfigError(f"{subject}: {problem} in {MAX_TRIES} tries; {reason}")


def missed_criteria(criteria: VehicleCriteria, summary: dict[str, Any]) -> str:
    """Describe what a flight misses of the criteria on the vehicle; empty if it meets them."""
    onset_s = min((fault["start_s"] for fault in summary["faults"]), default=None)
    found = msgspec.convert(summary["outcome"], VehicleOutcome)
    checks = check_vehicle(criteria, found, onset_s, under_autopilot=False)
    return ", ".join(
        f"{check.name} {check.value} (limit {check.limit})" for check in checks if not check.passed
    )
