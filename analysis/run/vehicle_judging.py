"""Add to the summary of a run what happened to the vehicle and which faults acted, and judge it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.judging.flight_signals import judge_requirements
from analysis.report.judging.vehicle_record import vehicle_outcome
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.results import read_results
from analysis.run.run_setup import RunSetup
from analysis.scoring.criteria import (
    CriterionCheck,
    check_requirements,
    check_vehicle,
    overall_verdict,
)
from analysis.scoring.requirements import RequirementResult
from mavproxy_fault.schedule.entries import Schedule, never_acted
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.tlog import Columns


def judge_vehicle_of_run(
    summary: dict[str, Any],
    columns: Columns,
    labels: Sequence[Label],
    setup: RunSetup,
    folder: Path,
    *,
    under_autopilot: bool = False,
) -> None:
    """Add `outcome` and `requirements` to a summary, and their checks to the verdict.

    `columns` are those of `sent.tlog`, from which a report of the run takes its outcome too.
    """
    t0_us = labels[0].t0_us if labels else None
    recording = add_derived_curves(recording_of_tlog(columns, t0_us=t0_us))
    found = vehicle_outcome(recording)
    summary["outcome"] = msgspec.to_builtins(found)
    onset_s = min(((one.start_us - one.t0_us) * 1e-6 for one in labels), default=None)
    add_checks(
        summary, check_vehicle(setup.criteria, found, onset_s, under_autopilot=under_autopilot)
    )
    results = read_results(folder / "results.jsonl")
    ground_m, estimators = setup.scenario.start.alt_m, setup.monitor.attitude.estimators
    # The simulator's controller has no estimate of its own.
    subject = "" if under_autopilot or len(estimators) != 1 else estimators[0]
    add_requirements(
        summary,
        judge_requirements(setup.requirements, recording, labels, results, ground_m, subject),
    )


def add_requirements(summary: dict[str, Any], judged: Sequence[RequirementResult]) -> None:
    """Add judged requirements to a summary, and to its criteria and verdict."""
    if judged:
        summary["requirements"] = msgspec.to_builtins(judged)
        add_checks(summary, check_requirements(judged))


def add_checks(summary: dict[str, Any], checks: Sequence[CriterionCheck]) -> None:
    """Add checks to the criteria and the verdict of a summary."""
    if checks:
        summary["criteria"] += [msgspec.structs.asdict(check) for check in checks]
        rows = [msgspec.convert(row, CriterionCheck) for row in summary["criteria"]]
        summary["verdict"] = overall_verdict(rows)


def report_unmatched_faults(
    summary: dict[str, Any], schedule: Schedule, labels: Sequence[Label]
) -> None:
    """Add faults that never acted to a summary; if no fault acted, PASS becomes NO VERDICT."""
    summary["never_acted"] = never_acted(schedule, {label.id for label in labels})
    if schedule.faults and not labels and summary["verdict"] == "PASS":
        summary["verdict"] = "NO VERDICT"
