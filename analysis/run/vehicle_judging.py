"""Add to the summary of a run what happened to the vehicle, and judge it by the criteria."""

from collections.abc import Sequence
from typing import Any

import msgspec

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.judging.vehicle_record import vehicle_outcome
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.scoring.criteria import Criteria, CriterionCheck, check_vehicle, overall_verdict
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.tlog import Columns


def judge_vehicle_of_run(
    summary: dict[str, Any],
    columns: Columns,
    labels: Sequence[Label],
    criteria: Criteria,
    *,
    under_autopilot: bool = False,
) -> None:
    """Add `outcome` to a summary, and its checks to the criteria and the verdict.

    `columns` are those of `sent.tlog`, from which a report of the run takes its outcome too.
    """
    t0_us = labels[0].t0_us if labels else None
    found = vehicle_outcome(add_derived_curves(recording_of_tlog(columns, t0_us=t0_us)))
    summary["outcome"] = msgspec.to_builtins(found)
    onset_s = min(((one.start_us - one.t0_us) * 1e-6 for one in labels), default=None)
    checks = check_vehicle(criteria, found, onset_s, under_autopilot=under_autopilot)
    if checks:
        summary["criteria"] += [msgspec.structs.asdict(check) for check in checks]
        rows = [msgspec.convert(row, CriterionCheck) for row in summary["criteria"]]
        summary["verdict"] = overall_verdict(rows)
