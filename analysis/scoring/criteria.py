"""Pass and fail: the limits a scenario sets on its own summary."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec


class Criteria(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits; what is not given is not judged. Faults are named by their ids in the schedule."""

    must_detect: tuple[str, ...] = ()
    must_isolate: tuple[str, ...] = ()
    max_delay_s: float | None = None
    max_false_alarms: int | None = None
    max_untestable_epochs: int | None = None
    max_attitude_rmse_deg: float | None = None
    max_position_rmse_m: float | None = None


class Check(msgspec.Struct, frozen=True, kw_only=True):
    """One criterion, what was found, and whether it held (None: the data cannot bear a verdict)."""

    name: str
    limit: float | int | str
    value: float | int | str | None
    passed: bool | None


def judge(criteria: Criteria, summary: Mapping[str, Any]) -> list[Check]:
    """Hold a summary against the criteria, one check per limit that was given."""
    rows = {row["id"]: row for row in summary["faults"]}
    checks = [
        Check(name=f"{id} detected", limit="detected", value=_verdict(rows, id), passed=found)
        for id in criteria.must_detect
        for found in [bool(id in rows and rows[id]["detected"])]
    ]
    checks += [
        Check(
            name=f"{id} isolated",
            limit="isolated",
            value=_verdict(rows, id),
            passed=_verdict(rows, id) == "isolated",
        )
        for id in criteria.must_isolate
    ]
    delays = [row["delay_s"] for row in rows.values() if row["delay_s"] is not None]
    attitude = summary["attitude_rmse_deg"]
    limits = (
        ("largest detection delay, s", criteria.max_delay_s, max(delays, default=None)),
        ("false alarms", criteria.max_false_alarms, summary["false_alarms"]),
        ("untestable epochs", criteria.max_untestable_epochs, summary["untestable_epochs"]),
        (
            "attitude RMSE, degrees",
            criteria.max_attitude_rmse_deg,
            attitude["max"] if attitude else None,
        ),
        ("position RMSE, m", criteria.max_position_rmse_m, summary["position_rmse_m"]),
    )
    return checks + [
        Check(name=name, limit=limit, value=value, passed=None if value is None else value <= limit)
        for name, limit, value in limits
        if limit is not None
    ]


def verdict(checks: Sequence[Check]) -> str:
    """FAIL if any check failed, PASS if all held, NO VERDICT if there is nothing to go by."""
    if any(check.passed is False for check in checks):
        return "FAIL"
    held = checks and all(check.passed for check in checks)
    return "PASS" if held else "NO VERDICT"


def _verdict(rows: Mapping[str, Mapping[str, Any]], id: str) -> str:
    return str(rows[id]["verdict"]) if id in rows else "never acted"
