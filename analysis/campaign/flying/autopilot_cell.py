"""Fly a cell with a real autopilot: one `mavproxy-fault run --autopilot` and its run folder."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from analysis.autopilots.flight_process import repeat_flight_process
from analysis.campaign.cell import CampaignFlight, monitor_verdict
from analysis.campaign.flying.autopilot_evidence import collect_evidence
from analysis.scoring.criteria import VehicleCriteria, check_vehicle
from analysis.scoring.vehicle_outcome import VehicleOutcome


def run_autopilot_cell(
    subject: str,
    run: Sequence[str],
    schedule: dict[str, Any],
    folder: Path,
    criteria: VehicleCriteria,
    *,
    kept: bool,
) -> CampaignFlight:
    """Fly a cell and check its criteria; arguments and errors as in `repeat_flight_process`."""
    started_s = time.monotonic()
    run_folder, summary = repeat_flight_process(
        subject, run, schedule, folder, kept=kept, must_act=bool(schedule["faults"])
    )
    evidence, flight_s = collect_evidence(run_folder)
    return CampaignFlight(
        {subject: evidence},
        duration_s=flight_s,
        wall_s=time.monotonic() - started_s,
        folder=str(run_folder),
        verdict=monitor_verdict(summary["faults"]),
        failed=missed_criteria(criteria, summary),
    )


def missed_criteria(criteria: VehicleCriteria, summary: dict[str, Any]) -> str:
    """Describe what a flight misses of the criteria on the vehicle; empty if it meets them."""
    onset_s = min((fault["start_s"] for fault in summary["faults"]), default=None)
    found = msgspec.convert(summary["outcome"], VehicleOutcome)
    checks = check_vehicle(criteria, found, onset_s, under_autopilot=False)
    return ", ".join(
        f"{check.name} {check.value} (limit {check.limit})" for check in checks if not check.passed
    )
