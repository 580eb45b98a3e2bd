"""Waypoints as the items of a mission, each the fields of a MISSION_ITEM_INT; no I/O."""

from collections.abc import Sequence

from analysis.autopilots.flight_plan import Waypoint

WAYPOINT, LAND = 16, 21  # MAV_CMD_NAV_
CHANGE_SPEED, GROUND_SPEED, SAME_THROTTLE = 178, 1, -1  # MAV_CMD_DO_CHANGE_SPEED
NO_PLACE, GLOBAL_RELATIVE_INT = 2, 6  # MAV_FRAME_MISSION, MAV_FRAME_
Item = dict[str, float]


def along(waypoints: Sequence[Waypoint]) -> list[Item]:
    """The corners, and before each where the speed changes a word on that."""
    items, speed_mps = [], None
    for waypoint in waypoints:
        if waypoint.speed_mps != speed_mps:
            speed_mps = waypoint.speed_mps
            items.append(change_speed(speed_mps))
        items.append(corner(waypoint))
    return items


def approach(waypoints: Sequence[Waypoint]) -> list[Item]:
    """The corners, the last of which is the ground to land on."""
    items = [corner(waypoint) for waypoint in waypoints]
    return [*items[:-1], {**items[-1], "command": LAND}]


def change_speed(speed_mps: float) -> Item:
    """How fast to go on; PX4 takes it in the frame of no place alone."""
    return {
        "frame": NO_PLACE,
        "command": CHANGE_SPEED,
        "param1": GROUND_SPEED,
        "param2": speed_mps,
        "param3": SAME_THROTTLE,
    }


def corner(waypoint: Waypoint) -> Item:
    """A place to fly through."""
    return {
        "frame": GLOBAL_RELATIVE_INT,
        "command": WAYPOINT,
        "x": round(waypoint.lat_deg * 1e7),
        "y": round(waypoint.lon_deg * 1e7),
        "z": waypoint.height_m,
    }
