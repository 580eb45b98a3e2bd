import pytest

from analysis.campaign.cell import Cell
from analysis.campaign.outcomes import OutcomeLimits, classify_flight, outcome_rank
from analysis.flying.flight_evidence import ATTITUDE, POSITION, Evidence, EvidenceCurve
from analysis.scoring.vehicle_outcome import VehicleEvent

CELL = Cell(subject="s", scenario="x", fault="f", magnitude=1.0, onset=10.0, duration_s=5.0)
TIMES = [float(t) for t in range(31)]
HEALTHY = [1.0] * 31


def evidence(value: list[float], *marks: VehicleEvent, name: str = ATTITUDE) -> Evidence:
    return Evidence({name: EvidenceCurve(TIMES, value)}, list(marks))


def bump(height: float, start: int = 11, end: int = 18) -> list[float]:
    return [1.0 + (height if start <= t < end else 0.0) for t in range(31)]


def outcome(flight: Evidence, reference: Evidence | None = None, **limits: float):
    return classify_flight(
        CELL, 10.0, flight, reference or evidence(HEALTHY), OutcomeLimits(**limits)
    )


def test_the_same_flight_is_unaffected() -> None:
    result = outcome(evidence(HEALTHY))
    assert (result.outcome, result.excursion_deg, result.recovery_s) == ("unaffected", 0.0, None)


def test_an_excursion_over_the_limit_is_degraded_and_its_recovery_counts_from_the_end() -> None:
    result = outcome(evidence(bump(6.0)))
    assert (result.outcome, result.excursion_deg, result.recovery_s) == ("degraded", 6.0, 3.0)


def test_errors_that_the_reference_flight_has_too_do_not_count() -> None:
    assert outcome(evidence(bump(6.0)), evidence(bump(6.0))).outcome == "unaffected"


def test_an_estimate_that_is_lost_without_the_fault_too_is_lost() -> None:
    broken = evidence(bump(60.0, 11, 31))
    assert outcome(broken, broken).outcome == "lost"


def test_events_before_the_onset_do_not_count() -> None:
    assert outcome(evidence(bump(60.0, 2, 9))).outcome == "unaffected"


def test_an_excursion_that_stays_never_recovers() -> None:
    result = outcome(evidence(bump(6.0, 11, 31)))
    assert (result.outcome, result.recovery_s) == ("degraded", None)


def test_an_estimate_of_nan_is_lost() -> None:
    values = bump(0.0)
    values[15] = float("nan")
    assert outcome(evidence(values)).outcome == "lost"


def test_positions_have_their_own_limits() -> None:
    def of(height: float) -> str:
        flight = evidence(bump(height), name=POSITION)
        return outcome(flight, evidence(HEALTHY, name=POSITION)).outcome

    assert [of(9.0), of(11.0), of(201.0)] == ["unaffected", "degraded", "lost"]


def test_a_new_alarm_is_a_detection_with_its_delay() -> None:
    marks = VehicleEvent(5.0, "detected", "imu"), VehicleEvent(12.5, "detected", "imu")
    result = outcome(evidence(HEALTHY, *marks))
    assert (result.outcome, result.detected_s, result.detected_by) == ("detected", 2.5, "imu")


def test_an_alarm_of_the_reference_flight_is_no_detection() -> None:
    reference = evidence(HEALTHY, VehicleEvent(12.0, "detected", "imu"))
    assert (
        outcome(evidence(HEALTHY, VehicleEvent(12.5, "detected", "imu")), reference).outcome
        == "unaffected"
    )


def test_the_worst_outcome_counts() -> None:
    marks = [
        VehicleEvent(11.0, "detected"),
        VehicleEvent(12.0, "failsafe", "LAND"),
        VehicleEvent(20.0, "crashed"),
    ]
    result = outcome(evidence(bump(6.0), *marks))
    assert (result.outcome, result.failsafe, result.failsafe_s) == ("crashed", "LAND", 2.0)


def test_an_aborted_flight_is_not_worse() -> None:
    assert outcome_rank("aborted") == -1
    assert not OutcomeLimits().is_worse("aborted")
    assert OutcomeLimits(worse_from="failsafe").is_worse("failsafe")
    assert not OutcomeLimits(worse_from="failsafe").is_worse("degraded")


def test_wrong_limits_are_reported() -> None:
    with pytest.raises(ValueError, match="worse_from = bad is unknown"):
        OutcomeLimits(worse_from="bad")
    with pytest.raises(ValueError, match="must be above 0"):
        OutcomeLimits(lost_deg=0.0)
