"""Waypoints as mission items."""

from analysis.autopilots.mission_items import landing_items, waypoint_items
from simvehicle.guidance.waypoints import Waypoint

SLOW = Waypoint(47.4, 8.5, 20.0, 3.0)
FAST = Waypoint(47.41, 8.5, 30.0, 6.0)


def test_a_change_of_speed_precedes_its_waypoint():
    items = waypoint_items([SLOW, SLOW, FAST])
    assert [(item["command"], item["frame"]) for item in items] == [
        (178, 2), (16, 6), (16, 6), (178, 2), (16, 6),
    ]  # fmt: skip
    assert [item["param2"] for item in items if item["command"] == 178] == [3.0, 6.0]
    assert (items[-1]["x"], items[-1]["y"], items[-1]["z"]) == (474_100_000, 85_000_000, 30.0)


def test_the_last_item_of_an_approach_is_land():
    items = landing_items([FAST, SLOW])
    assert [item["command"] for item in items] == [16, 21]
    assert items[-1]["x"] == 474_000_000
