from typing import Any

import pytest

from simvehicle.autopilot.enums import FlightMode, LandedState
from simvehicle.autopilot.flight_goals import GoalKind


def names(messages: list[Any]) -> list[str]:
    return [m.get_type() for m in messages]


def test_an_armed_vehicle_on_the_ground_waits(station: Any) -> None:
    station.command(400, 1)
    assert station.flight.goal.kind is GoalKind.IDLE


def test_take_off_climbs_to_the_parameter_and_holds(station: Any) -> None:
    station.command(400, 1)
    station.command(22)
    assert station.flight.goal.r_ned_m.tolist() == pytest.approx([0, 0, -10])
    station.at([0, 0, -4])
    assert station.flight.landed is LandedState.TAKEOFF
    station.at([0, 0, -9.5])
    assert station.flight.mode is FlightMode.HOLD
    assert station.flight.goal.r_ned_m.tolist() == pytest.approx([0, 0, -10])


def test_the_height_of_a_take_off_command_is_above_sea_level(station: Any) -> None:
    station.command(400, 1)
    station.command(22, *[float("nan")] * 6, 488.0 + 33.0)
    assert station.flight.goal.r_ned_m[2] == pytest.approx(-33.0)


def test_a_take_off_below_the_least_height_climbs_to_it(station: Any) -> None:
    station.command(400, 1)
    # MAVProxy's `takeoff 3`: in MAVLink's frame that is below the field.
    station.command(22, 0, 0, 0, 0, 0, 0, 3)
    assert station.flight.goal.r_ned_m.tolist() == pytest.approx([0, 0, -10])


def test_a_take_off_commanded_before_arming_starts_with_arming(station: Any) -> None:
    station.command(22)
    assert station.flight.goal.kind is GoalKind.IDLE
    station.command(400, 1)
    assert station.flight.goal.kind is GoalKind.FLY


def test_a_mission_is_flown_item_by_item_and_then_held(station: Any, upload: Any) -> None:
    upload([(22, 0, 0, 10), (16, 30, 0, 10), (16, 30, 40, 12)])
    station.command(400, 1)
    station.command(176, 1, 4, 4)
    reached = []
    for place in ([0, 0, 0], [0, 0, -10], [15, 0, -10], [30, 0, -10], [30, 40, -12]):
        said = station.at(place, 0.1) + station.at(place, 0.1)
        reached += [m.seq for m in said if m.get_type() == "MISSION_ITEM_REACHED"]
    assert reached == [0, 1, 2]
    assert station.flight.mode is FlightMode.HOLD
    assert station.flight.goal.r_ned_m.tolist() == pytest.approx([30, 40, -12], abs=0.05)


def test_landing_disarms_after_two_seconds_on_the_ground(station: Any) -> None:
    station.command(400, 1)
    station.at([0, 0, -5])
    station.command(21)
    assert station.flight.goal.kind is GoalKind.LAND
    station.at([0, 0, -1], 1.0)
    assert station.flight.landed is LandedState.LANDING
    station.at([0, 0, 0], 1.0)
    station.at([0, 0, 0], 1.9)
    assert station.flight.armed
    station.at([0, 0, 0], 0.2)
    assert not station.flight.armed
    assert station.flight.goal.kind is GoalKind.IDLE


def test_return_goes_home_at_its_height_and_lands(station: Any) -> None:
    station.command(400, 1)
    station.at([50, 0, -5])
    station.command(20)
    assert station.flight.goal.r_ned_m.tolist() == pytest.approx([0, 0, -30], abs=0.05)
    station.at([0, 0, -30], 1.0)
    assert station.flight.mode is FlightMode.LAND


def test_a_mission_that_ends_in_a_landing_reports_its_last_item(station: Any, upload: Any) -> None:
    upload([(21, 0, 0, 0)])
    station.command(400, 1)
    station.at([0, 0, -5])
    station.command(300)
    assert station.flight.mode is FlightMode.MISSION
    said = [m for _ in range(5) for m in station.at([0, 0, 0], 0.6)]
    assert "MISSION_ITEM_REACHED" in names(said)
    assert not station.flight.armed


def test_a_pause_holds_and_the_mission_goes_on(station: Any, upload: Any) -> None:
    upload([(16, 30, 0, 10), (16, 60, 0, 10)])
    station.command(400, 1)
    station.at([0, 0, -10])
    station.command(300)
    station.at([30, 0, -10], 0.1)
    station.command(193, 0)
    assert station.flight.mode is FlightMode.HOLD
    station.command(193, 1)
    station.at([31, 0, -10], 0.1)
    assert station.flight.goal.r_ned_m[0] == pytest.approx(60, abs=0.05)


def test_a_waypoint_holds_for_its_time(station: Any) -> None:
    station.send("mission_count", 1, 1, 2, 0)
    for seq in range(2):
        station.send(
            "mission_item_int", 1, 1, seq, 6, 16, 0, 1, 3.0, 0, 0, 0, 473977420, 85455940, 10, 0
        )
    station.command(400, 1)
    station.at([0, 0, -10])
    station.command(300)
    station.at([0, 0, -10], 0.1)
    station.at([0, 0, -10], 2.8)
    assert station.flight.seq == 0
    station.at([0, 0, -10], 0.3)
    assert station.flight.seq == 1


def test_clearing_the_mission_in_flight_holds(station: Any, upload: Any) -> None:
    upload([(16, 30, 0, 10)])
    station.command(400, 1)
    station.at([0, 0, -10])
    station.command(300)
    station.send("mission_clear_all", 1, 1, 0)
    station.at([5, 0, -10], 0.1)
    assert station.flight.mode is FlightMode.HOLD


def test_impossible_speeds_are_denied(station: Any) -> None:
    assert station.command(178, 1, 8.0)[0].result == 0
    assert station.flight.goal.speed_mps == 8.0
    assert station.command(178, 1, 0.1)[0].result == 2
    assert station.command(178, 1, -1)[0].result == 0
    assert station.flight.goal.speed_mps is None
