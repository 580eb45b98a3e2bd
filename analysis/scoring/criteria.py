"""Pass and fail: the checks of every flight, and the limits a scenario adds.

Unless a scenario allows it, a flight fails if an observable fault was missed or a healthy sensor
was isolated.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from analysis.scoring.outcome import ISOLATED, LATE, MISSED, NOT_JUDGED
from analysis.scoring.requirements import RequirementResult
from analysis.scoring.vehicle_outcome import (
    CRASHED,
    FAILSAFE,
    VEHICLE_OUTCOMES,
    VehicleOutcome,
    outcome_rank,
)

AT_MOST = "at most "


class FailsafeCriterion(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The failsafe that has to act: the mode it enters, and how long after the first fault."""

    mode: str
    within_s: float | None = None


class VehicleCriteria(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of what happens to the vehicle: `outcome` as "at most degraded"."""

    outcome: str | None = None
    failsafe: FailsafeCriterion | None = None
    impact_mps: float | None = None
    excursion_m: float | None = None

    def __post_init__(self) -> None:
        if self.outcome is not None and worst_allowed(self.outcome) not in VEHICLE_OUTCOMES:
            known = ", ".join(AT_MOST + word for word in VEHICLE_OUTCOMES)
            raise ValueError(f"outcome = {self.outcome} is unknown; known: {known}")


class Criteria(VehicleCriteria, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits; those that are not given are not checked. Faults are named by their schedule ids.

    `may_miss` allows missed faults by id, fault or preset; `may_blame` allows wrong isolations by
    channel or sensor. Shares are of all GNSS epochs, between 0 and 1; errors are those of the
    detector's own position.
    """

    must_detect: tuple[str, ...] = ()
    must_isolate: tuple[str, ...] = ()
    may_miss: tuple[str, ...] = ()
    may_blame: tuple[str, ...] = ()
    max_delay_s: float | None = None
    max_false_alarms: int | None = None
    max_untestable_epochs: int | None = None
    max_attitude_rmse_deg: float | None = None
    max_position_rmse_m: float | None = None
    min_tested_share: float | None = None
    max_unexplained_share: float | None = None
    max_horizontal_95_m: float | None = None
    max_vertical_95_m: float | None = None


def worst_allowed(outcome: str) -> str:
    """Return the worst outcome that a criterion allows, as `at most degraded`."""
    return outcome.removeprefix(AT_MOST)


def receiver_criteria(with_truth: bool) -> Criteria:
    """Default criteria for a recording of a receiver alone.

    At least 90 % of the epochs are tested, and at most 1 % have an unexplained alarm. With a known
    truth: the accuracy that GPS itself specifies as global average (SPS Performance Standard, 5th
    edition, 2020, section 3.8: 8 m and 13 m at 95 %).
    """
    criteria = Criteria(min_tested_share=0.9, max_unexplained_share=0.01)
    if not with_truth:
        return criteria
    return msgspec.structs.replace(criteria, max_horizontal_95_m=8.0, max_vertical_95_m=13.0)


class CriterionCheck(msgspec.Struct, frozen=True):
    """One criterion, its value, and whether it passed (None: the data are insufficient)."""

    name: str
    limit: float | int | str
    value: float | int | str | None
    passed: bool | None


def check_criteria(criteria: Criteria, summary: Mapping[str, Any]) -> list[CriterionCheck]:
    """Check a summary against the criteria, one check per given limit."""
    rows = summary["faults"]
    # Without labels no alarm can be called false.
    checks = [] if summary["false_by_channel"] is None else _check_faults(criteria, summary)
    for ids, word, key, value in (
        (criteria.must_detect, "detected", "detected", True),
        (criteria.must_isolate, "isolated", "verdict", ISOLATED),
    ):
        for id in ids:
            own = [row for row in rows if row["id"] == id]
            verdicts = ", ".join(dict.fromkeys(str(row["verdict"]) for row in own))
            # A fault that never acted was not detected.
            right = bool(own) and all(row[key] == value for row in own)
            checks.append(CriterionCheck(f"{id} {word}", word, verdicts or "never acted", right))
    delays = [row["delay_s"] for row in rows if row["delay_s"] is not None]
    attitude = summary["attitude_rmse_deg"] or {}
    errors = summary.get("position_error", {}).get("filter", {})
    for name, most, found in (
        ("largest detection delay, s", criteria.max_delay_s, max(delays, default=None)),
        ("false alarms", criteria.max_false_alarms, summary["false_alarms"]),
        ("untestable epochs", criteria.max_untestable_epochs, summary["untestable_epochs"]),
        ("attitude RMSE, degrees", criteria.max_attitude_rmse_deg, attitude.get("max")),
        ("position RMSE, m", criteria.max_position_rmse_m, summary["position_rmse_m"]),
        (
            "horizontal error at 95 %, m",
            criteria.max_horizontal_95_m,
            errors.get("horizontal_95_m"),
        ),
        ("vertical error at 95 %, m", criteria.max_vertical_95_m, errors.get("vertical_95_m")),
        (
            "share of epochs with an unexplained alarm",
            criteria.max_unexplained_share,
            _epoch_share(summary, "unexplained_epochs"),
        ),
    ):
        checks += _at_most(name, most, found)
    least, untested = criteria.min_tested_share, _epoch_share(summary, "untestable_epochs")
    if least is not None:
        tested = None if untested is None else round(1.0 - untested, 4)
        passed = None if tested is None else tested >= least
        checks.append(CriterionCheck("share of epochs tested", least, tested, passed))
    return checks


def _at_most(name: str, most: float | None, value: float | None) -> list[CriterionCheck]:
    """The check of an upper limit, if there is one; without a value it has no verdict."""
    if most is None:
        return []
    return [CriterionCheck(name, most, value, None if value is None else value <= most)]


def check_vehicle(
    criteria: VehicleCriteria,
    found: VehicleOutcome,
    onset_s: float | None,
    *,
    under_autopilot: bool,
) -> list[CriterionCheck]:
    """Check what happened to the vehicle; `onset_s` is the start of the first fault.

    Under an autopilot, a flight without criteria on the vehicle fails if it crashed, lost control
    or flew away.
    """
    rank = outcome_rank(found.outcome)
    # Only criteria of the scenario need a verdict: a flight may have ended before its take-off.
    limit = criteria.outcome or (AT_MOST + FAILSAFE if under_autopilot and rank >= 0 else None)
    checks = []
    if limit is not None:
        passed = None if rank < 0 else rank <= outcome_rank(worst_allowed(limit))
        # An autopilot that reports a crash never passes.
        passed = passed and found.outcome != CRASHED
        checks.append(CriterionCheck("vehicle outcome", limit, found.outcome, passed))
    if criteria.failsafe is not None:
        checks.append(_check_failsafe(criteria.failsafe, found, onset_s))
    checks += _at_most("impact, m/s", criteria.impact_mps, found.impact_mps)
    return checks + _at_most("excursion, m", criteria.excursion_m, found.excursion_m)


def check_requirements(results: Sequence[RequirementResult]) -> list[CriterionCheck]:
    """Return a check for each requirement; one that the flight does not show has no verdict."""
    return [CriterionCheck(one.name, one.formula, one.describe(), one.met) for one in results]


def _check_failsafe(
    wanted: FailsafeCriterion, found: VehicleOutcome, onset_s: float | None
) -> CriterionCheck:
    """Check that the wanted mode was entered by a failsafe in time."""
    within = "" if wanted.within_s is None else f" within {wanted.within_s:g} s"
    acted = [event for event in found.events if event.kind == FAILSAFE]
    since_s = onset_s or 0.0
    right = [
        event
        for event in acted
        if event.text.partition(":")[0] == wanted.mode and event.t_s >= since_s
    ]
    after_s = right[0].t_s - since_s if right else None
    passed = after_s is not None and (wanted.within_s is None or after_s <= wanted.within_s)
    others = ", ".join(event.text.partition(":")[0] for event in acted) or "none"
    value = others if after_s is None else f"{wanted.mode} after {after_s:.1f} s"
    return CriterionCheck("failsafe", wanted.mode + within, value, passed)


def _epoch_share(summary: Mapping[str, Any], key: str) -> float | None:
    epochs = summary.get("epochs")  # a report's log may have none
    return round(summary[key] / epochs, 4) if epochs else None


def _check_faults(criteria: Criteria, summary: Mapping[str, Any]) -> list[CriterionCheck]:
    """The checks of every flight with known faults."""
    isolated = [
        name
        for row in summary["false_by_channel"]
        for name in row["blamed"]
        # By the isolated sensor or by the channel that isolated it.
        if not {name, row["channel"]} & set(criteria.may_blame)
    ]
    names = _none_or(dict.fromkeys(isolated))
    wrong = CriterionCheck("isolated wrongly", "none", names, not isolated)
    return [*check_missed_faults(criteria, summary["faults"]), wrong]


def check_missed_faults(
    criteria: Criteria, rows: Sequence[Mapping[str, Any]]
) -> list[CriterionCheck]:
    """Check that no observable fault was missed; empty where no fault acted."""
    if not rows:
        return []
    missed = [
        row["id"]
        for row in rows
        if row["verdict"] in (MISSED, LATE)
        # By id, kind or preset: whichever a scenario names.
        and not {row["id"], row["fault"], row["preset"]} & set(criteria.may_miss)
    ]
    # Faults that no channel can observe give no verdict.
    judged = any(row["verdict"] != NOT_JUDGED for row in rows)
    names = _none_or(dict.fromkeys(missed)) if judged else None
    passed = not missed if judged else None
    return [CriterionCheck("faults missed", "none", names, passed)]


def _none_or(names: Mapping[str, None]) -> str:
    return ", ".join(names) or "none"


def overall_verdict(checks: Sequence[CriterionCheck]) -> str:
    """FAIL if any check failed, PASS if all passed, NO VERDICT if the data are insufficient."""
    if any(check.passed is False for check in checks):
        return "FAIL"
    # An empty list of checks does not pass.
    all_passed = checks and all(check.passed for check in checks)
    return "PASS" if all_passed else "NO VERDICT"
