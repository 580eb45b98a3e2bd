import numpy as np
import pytest

from analysis.scoring.criteria import Criteria, FailsafeCriterion, check_vehicle
from analysis.scoring.vehicle_outcome import (
    TimedText,
    VehicleMotion,
    VehicleRecord,
    describe_vehicle,
    judge_vehicle,
)

T_S = np.arange(0.0, 60.0, 0.02)
TAKE_OFF_S, CLIMB_MPS, HOVER_M = 5.0, 2.0, 10.0


def flight(*, down_at_s=40.0, sink_mps=0.8, tilt_deg=2.0, east_mps=0.0, **record):
    """Climb to 10 m, hover, and descend at a constant rate; rest on the ground afterwards."""
    height_m = np.clip((T_S - TAKE_OFF_S) * CLIMB_MPS, 0.0, HOVER_M)
    height_m = np.minimum(height_m, np.maximum(HOVER_M - (T_S - down_at_s) * sink_mps, 0.0))
    sink = -np.gradient(height_m, T_S)
    east_m = east_mps * np.clip(T_S - 20.0, 0.0, None)
    zeros = np.zeros_like(T_S)
    tilt = np.broadcast_to(tilt_deg, T_S.shape).astype(float)
    motion = VehicleMotion(T_S, height_m, zeros, east_m, sink, tilt, True)
    modes = [TimedText(0.0, "GUIDED"), TimedText(down_at_s, "LAND")]
    commands = [TimedText(4.0, "GUIDED"), TimedText(down_at_s - 0.2, "LAND")]
    given = {"armed": [(3.0, 58.0)], "modes": modes, "commands": commands, "hovers": True} | record
    return judge_vehicle(VehicleRecord(motion, **given))


def kinds(found):
    return [event.kind for event in found.events]


def test_a_commanded_landing_has_no_other_word() -> None:
    found = flight()
    assert (found.outcome, found.source) == ("landed as commanded", "truth")
    assert kinds(found) == ["take-off", "touchdown"]
    assert found.impact_mps == pytest.approx(0.8, abs=0.05)


@pytest.mark.parametrize(("sink_mps", "outcome"), [(2.5, "landed as commanded"), (3.6, "crashed")])
def test_an_impact_over_three_metres_per_second_is_a_crash(sink_mps, outcome) -> None:
    found = flight(sink_mps=sink_mps)
    assert found.outcome == outcome
    assert found.impact_mps == pytest.approx(sink_mps, abs=0.1)


def test_a_soft_end_on_the_side_is_a_crash() -> None:
    found = flight(tilt_deg=np.where(T_S > 55.0, 90.0, 2.0))
    assert (found.outcome, found.end_tilt_deg) == ("crashed", 90.0)


def test_a_vehicle_that_never_moved_and_may_never_have_been_armed_has_not_crashed() -> None:
    lying = {"tilt_deg": np.where(T_S > 10.0, 112.0, 2.0), "armed": None, "flies": False}
    assert flight(**lying).outcome == "not judged"
    assert flight(**lying | {"armed": [(3.0, 58.0)]}).outcome == "crashed"


def test_a_crash_in_the_words_of_the_autopilot_is_a_crash() -> None:
    texts = [TimedText(50.0, "Crash: Disarming: AngErr=173>30, Accel=0.9<3.0")]
    assert flight(texts=texts).outcome == "crashed"
    assert flight(texts=[TimedText(50.0, "Crash check disabled")]).outcome != "failsafe"


@pytest.mark.parametrize(
    "text",
    [
        "Crash check disabled", "Crash check enabled", "Failsafe enabled",
        "Failsafe mode deactivated", "Battery failsafe action set to LAND", "Failsafe warning",
        "vibration compensation: error 1",
    ],
)  # fmt: skip
def test_a_setting_and_an_end_are_neither_crash_nor_failsafe(text: str) -> None:
    assert flight(texts=[TimedText(50.0, text)]).outcome == flight().outcome


def test_a_simulator_that_reports_a_soft_touchdown_reports_no_crash() -> None:
    for speed_mps, outcome in ((0.5, "landed as commanded"), (3.4, "crashed")):
        texts = [TimedText(50.0, f"SIM Hit ground at {speed_mps} m/s")]
        assert flight(texts=texts).outcome == outcome


@pytest.mark.parametrize(
    ("blow_mps2", "armed_until_s", "outcome"),
    [
        (170.0, 31.0, "crashed"),  # a wall, and the motors cut
        (170.0, 58.0, "landed as commanded"),  # it flies on
        (45.0, 31.0, "landed as commanded"),
    ],
)
def test_a_blow_that_ends_the_flight_is_a_crash(blow_mps2, armed_until_s, outcome) -> None:
    felt_mps2 = np.full_like(T_S, 9.8) + 4.0 * np.sin(50.0 * T_S)
    felt_mps2[1500] += blow_mps2
    found = flight(force=(T_S, felt_mps2), armed=[(3.0, armed_until_s)])
    assert found.outcome == outcome
    assert [event.t_s for event in found.events if event.kind == "crashed"] == (
        [30.0] if outcome == "crashed" else []
    )


def test_a_touchdown_that_the_imu_feels_hard_is_no_crash() -> None:
    felt_mps2 = np.full_like(T_S, 9.8)
    felt_mps2[np.searchsorted(T_S, 52.4)] += 140.0
    found = flight(force=(T_S, felt_mps2), armed=[(3.0, 53.5)])
    assert found.outcome == "landed as commanded"


def test_a_vehicle_thrown_over_in_the_air_lost_control_unless_it_flies_a_flip() -> None:
    tilt = np.where((T_S > 20.0) & (T_S < 20.5), 120.0, 2.0)
    assert flight(tilt_deg=tilt).outcome == "lost control"
    modes = [TimedText(0.0, "GUIDED"), TimedText(19.0, "FLIP"), TimedText(21.0, "GUIDED")]
    assert flight(tilt_deg=tilt, modes=modes).outcome != "lost control"


def test_a_hovering_vehicle_that_leaves_its_place_flew_away() -> None:
    found = flight(east_mps=15.0)
    assert found.outcome == "flew away"
    assert found.excursion_m > 200.0
    assert flight(east_mps=1.0).outcome == "degraded"
    # Circling or commanded vehicles may move.
    assert flight(east_mps=15.0, hovers=False).outcome == "landed as commanded"


def test_a_mode_that_nobody_commanded_is_a_failsafe_with_its_reason() -> None:
    modes = [TimedText(0.0, "GUIDED"), TimedText(25.0, "LAND")]
    commands = [TimedText(4.0, "GUIDED")]
    texts = [TimedText(25.1, "EKF Failsafe: changed to LAND Mode")]
    found = flight(modes=modes, commands=commands, texts=texts)
    assert (found.outcome, found.failsafe, found.failsafe_s) == ("failsafe", "LAND", 25.0)
    assert found.reason == "EKF Failsafe: changed to LAND Mode"
    assert "LAND: EKF Failsafe: changed to LAND Mode at 25.0 s" in describe_vehicle(found)
    assert flight(modes=modes, commands=commands).outcome == "failsafe"
    # A log that cannot hold commands does not say who chose the mode.
    assert flight(modes=modes, commands=None).outcome == "landed as commanded"
    assert flight(modes=modes, commands=None, texts=texts).outcome == "failsafe"


def test_a_failsafe_on_the_ground_is_named_too() -> None:
    modes = [TimedText(0.0, "GUIDED"), TimedText(3.5, "LAND")]
    texts = [TimedText(3.6, "EKF Failsafe: changed to LAND Mode")]
    record = {"modes": modes, "commands": [TimedText(0.4, "GUIDED")], "texts": texts}
    lifted_off = flight(**record)
    assert (lifted_off.outcome, lifted_off.failsafe_s) == ("failsafe", 3.5)
    grounded = judge_vehicle(VehicleRecord(None, [(3.0, 5.0)], modes, record["commands"], texts))
    assert (grounded.outcome, grounded.failsafe) == ("failsafe", "LAND")
    behind_a_crash = flight(
        sink_mps=8.0, modes=[TimedText(0.0, "GUIDED"), TimedText(52.0, "LAND")], commands=[]
    )
    assert (behind_a_crash.outcome, behind_a_crash.failsafe) == ("crashed", "LAND")
    assert "landed uncommanded" not in kinds(behind_a_crash)


def test_a_failsafe_between_two_flights_is_none() -> None:
    said = [TimedText(58.5, "Radio Failsafe - Disarming")]
    assert flight(armed=[(3.0, 58.0), (59.0, 59.5)], texts=said).failsafe == ""


def test_the_end_of_a_take_off_or_a_mission_is_no_failsafe() -> None:
    names = ("TAKEOFF", "LOITER", "MISSION", "LOITER", "LAND")
    modes = [TimedText(4.0 + 8.0 * n, name) for n, name in enumerate(names)]
    commands = [TimedText(3.9, "TAKEOFF"), TimedText(19.0, "mission"), TimedText(35.9, "LAND")]
    assert flight(modes=modes, commands=commands).outcome == "landed as commanded"
    # Words behind it are those of a failsafe that keeps the mode.
    held = [TimedText(13.3, "Failsafe activated: entering Hold for 5 seconds")]
    found = flight(modes=modes, commands=commands, texts=held)
    assert (found.outcome, found.failsafe, found.failsafe_s) == ("failsafe", "LOITER", 13.3)


def test_a_landing_that_nobody_commanded_is_named() -> None:
    modes = [TimedText(0.0, "GUIDED")]
    found = flight(modes=modes, commands=[TimedText(4.0, "GUIDED")])
    assert found.outcome == "landed uncommanded"


def test_a_wrong_estimate_degrades_and_a_vehicle_that_follows_a_far_one_flew_away() -> None:
    def off(metres, **motion):
        return flight(errors_m=(T_S, np.where(T_S > 20.0, metres, 0.0)), hovers=False, **motion)

    outcomes = [off(metres).outcome for metres in (9.0, 11.0, 400.0)]
    assert outcomes == ["landed as commanded", "degraded", "degraded"]
    assert off(400.0).excursion_m == 0.0, "its estimate has jumped, and the vehicle stayed"
    assert off(201.0, east_mps=15.0).outcome == "flew away"
    assert off(9.0, east_mps=15.0).excursion_m == 9.0
    assert flight(errors_deg=(T_S, np.full_like(T_S, 6.0))).outcome == "degraded"


def test_a_flight_that_never_took_off_is_not_judged() -> None:
    assert judge_vehicle(VehicleRecord(None)).outcome == "not judged"
    assert flight(armed=[]).outcome == "not judged"


def checks(criteria, found, *, under_autopilot=True):
    rows = check_vehicle(criteria, found, 20.0, under_autopilot=under_autopilot)
    return [(row.name, row.passed) for row in rows]


def test_under_an_autopilot_a_crash_fails_without_any_criterion() -> None:
    crash, landing = flight(sink_mps=8.0), flight()
    assert checks(Criteria(), crash) == [("vehicle outcome", False)]
    assert checks(Criteria(), landing) == [("vehicle outcome", True)]
    assert checks(Criteria(), crash, under_autopilot=False) == []
    assert checks(Criteria(outcome="at most crashed"), crash) == [("vehicle outcome", False)]


def test_criteria_limit_outcome_impact_and_excursion() -> None:
    drift = flight(east_mps=1.0)
    limits = Criteria(outcome="at most degraded", impact_mps=1.0, excursion_m=5.0)
    assert checks(limits, drift) == [
        ("vehicle outcome", True), ("impact, m/s", True), ("excursion, m", False),
    ]  # fmt: skip
    with pytest.raises(ValueError, match="outcome = at most broken is unknown"):
        Criteria(outcome="at most broken")


@pytest.mark.parametrize(("mode", "within_s", "passed"), [
    ("LAND", 6.0, True), ("LAND", None, True), ("LAND", 4.0, False), ("RTL", 6.0, False),
])  # fmt: skip
def test_the_failsafe_has_to_act_in_its_mode_and_time(mode, within_s, passed) -> None:
    modes = [TimedText(0.0, "GUIDED"), TimedText(25.0, "LAND")]
    found = flight(modes=modes, commands=[TimedText(4.0, "GUIDED")])
    wanted = FailsafeCriterion(mode=mode, within_s=within_s)
    assert ("failsafe", passed) in checks(Criteria(failsafe=wanted), found)
