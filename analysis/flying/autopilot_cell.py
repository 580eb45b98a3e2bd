"""Fly a cell with a real autopilot: one `mavproxy-fault run --autopilot` and its run folder."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from analysis.autopilots.flight_process import repeat_flight_process
from analysis.flying.autopilot_evidence import collect_evidence
from analysis.flying.flight_evidence import CampaignFlight, monitor_verdict
from analysis.scoring.criteria import VehicleCriteria, check_vehicle
from analysis.scoring.requirements import RequirementResult
from analysis.scoring.vehicle_outcome import VehicleOutcome


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
    """Fly a cell and check its criteria; arguments and errors as in `repeat_flight_process`. Unless
    its fault `must_act`, a flight counts in which the fault's condition never came."""
    started_s = time.monotonic()
    run_folder, summary = repeat_flight_process(
        subject, run, schedule, folder, kept=kept, must_act=must_act and bool(schedule["faults"])
    )
    evidence, flight_s = collect_evidence(run_folder)
    faults, judged = summary["faults"], summary.get("requirements", [])
    begun_s = min((fault["start_s"] for fault in faults), default=None)
    off_ground_s = summary["autopilot"]["moments_s"]["take-off"]
    return CampaignFlight(
        {subject: evidence},
        duration_s=flight_s,
        wall_s=time.monotonic() - started_s,
        folder=str(run_folder),
        verdict=monitor_verdict(faults),
        failed=missed_criteria(criteria, summary) if criteria else "",
        requirements={subject: msgspec.convert(judged, list[RequirementResult])},
        fault_s=None if begun_s is None else round(begun_s - off_ground_s, 3),
    )


def missed_criteria(criteria: VehicleCriteria, summary: dict[str, Any]) -> str:
    """Describe what a flight misses of the criteria on the vehicle; empty if it meets them."""
    onset_s = min((fault["start_s"] for fault in summary["faults"]), default=None)
    found = msgspec.convert(summary["outcome"], VehicleOutcome)
    checks = check_vehicle(criteria, found, onset_s, under_autopilot=False)
    return ", ".join(
        f"{check.name} {check.value} (limit {check.limit})" for check in checks if not check.passed
    )
