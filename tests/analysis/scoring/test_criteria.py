"""Criteria against a summary."""

from typing import Any

import msgspec
import pytest

from analysis.scoring.criteria import Criteria, check_criteria, overall_verdict, receiver_criteria


def fault(**changes: Any) -> dict[str, Any]:
    base = {"id": "step", "fault": "bias", "preset": "satellite-step"}
    return base | {"detected": True, "delay_s": 0.2, "verdict": "isolated"} | changes


def isolated_wrongly(name: str) -> dict[str, Any]:
    return {"channel": "baro", "outside": 0, "inside": 1, "blamed": [name]}


def summary(**changes: Any) -> dict[str, Any]:
    base = {
        "faults": [fault()],
        "false_alarms": 0,
        "false_by_channel": [],
        "untestable_epochs": 0,
        "attitude_rmse_deg": {"roll": 1.0, "pitch": 0.5, "yaw": 2.0, "max": 2.0},
        "position_rmse_m": 1.5,
    }
    return base | changes


ALL = Criteria(
    must_detect=("step",),
    must_isolate=("step",),
    max_delay_s=1.0,
    max_false_alarms=0,
    max_untestable_epochs=0,
    max_attitude_rmse_deg=5.0,
    max_position_rmse_m=5.0,
)


def test_a_summary_inside_every_limit_passes() -> None:
    checks = check_criteria(ALL, summary())
    assert len(checks) == 9
    assert overall_verdict(checks) == "PASS"


@pytest.mark.parametrize(
    "change",
    [
        {"faults": []},
        {"faults": [fault(delay_s=3.0)]},
        {"faults": [fault(verdict="wrong")]},
        {"faults": [fault(detected=False, verdict="missed"), fault()]},
        {"false_by_channel": [isolated_wrongly("baro")]},
        {"false_alarms": 1},
        {"untestable_epochs": 1},
        {"attitude_rmse_deg": {"max": 5.1}},
        {"position_rmse_m": 5.1},
    ],
)
def test_each_limit_can_fail_the_run(change: dict[str, Any]) -> None:
    assert overall_verdict(check_criteria(ALL, summary(**change))) == "FAIL"


@pytest.mark.parametrize(
    ("change", "loosened"),
    [
        ({"faults": [fault(verdict="missed")]}, {"may_miss": ("step",)}),
        ({"faults": [fault(verdict="missed")]}, {"may_miss": ("bias",)}),
        ({"faults": [fault(verdict="late")]}, {"may_miss": ("satellite-step",)}),
        ({"false_by_channel": [isolated_wrongly("baro")]}, {"may_blame": ("baro",)}),
    ],
)
def test_a_miss_or_a_wrong_isolation_fails_by_default_and_can_be_allowed(
    change: dict[str, Any], loosened: dict[str, Any]
) -> None:
    assert overall_verdict(check_criteria(Criteria(), summary(**change))) == "FAIL"
    assert overall_verdict(check_criteria(Criteria(**loosened), summary(**change))) == "PASS"


def test_a_fault_that_no_channel_observes_gives_no_verdict() -> None:
    unseen = summary(faults=[fault(verdict="not judged")])
    assert overall_verdict(check_criteria(Criteria(), unseen)) == "NO VERDICT"


def test_without_labels_and_criteria_there_is_no_verdict() -> None:
    assert (
        overall_verdict(check_criteria(Criteria(), summary(faults=[], false_by_channel=None)))
        == "NO VERDICT"
    )


def test_a_value_that_was_not_measured_gives_no_verdict() -> None:
    checks = check_criteria(Criteria(max_position_rmse_m=1.0), summary(position_rmse_m=None))
    assert [check.passed for check in checks] == [True, True, None]
    assert overall_verdict(checks) == "NO VERDICT"


def test_an_unknown_criterion_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match="max_smoke"):
        msgspec.convert({"max_smoke": 1}, Criteria)


RECEIVER = {
    "false_by_channel": None,
    "faults": [],
    "epochs": 1000,
    "unexplained_epochs": 10,
    "untestable_epochs": 100,
    "position_error": {"filter": {"horizontal_95_m": 8.0, "vertical_95_m": 13.0}},
}


@pytest.mark.parametrize(
    ("change", "with_truth", "expected"),
    [
        ({}, True, "PASS"),
        ({"position_error": {}}, False, "PASS"),
        ({"position_error": {}}, True, "NO VERDICT"),
        ({"unexplained_epochs": 11}, False, "FAIL"),
        ({"untestable_epochs": 101}, False, "FAIL"),
        ({"position_error": {"filter": {"horizontal_95_m": 8.1}}}, True, "FAIL"),
        ({"epochs": 0, "untestable_epochs": 0}, False, "NO VERDICT"),
    ],
)
def test_a_receivers_recording_is_judged_by_its_epochs_and_errors(
    change: dict[str, Any], with_truth: bool, expected: str
) -> None:
    found = summary(**(RECEIVER | change))
    assert overall_verdict(check_criteria(receiver_criteria(with_truth), found)) == expected
