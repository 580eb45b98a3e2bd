"""Waypoints as the items of a mission, each the fields of a MISSION_ITEM_INT; no I/O."""

from collections.abc import Sequence

from simvehicle.guidance.waypoints import Waypoint

WAYPOINT, LAND = 16, 21  # MAV_CMD_NAV_
CHANGE_SPEED, GROUND_SPEED, SAME_THROTTLE = 178, 1, -1  # MAV_CMD_DO_CHANGE_SPEED
FRAME_MISSION, GLOBAL_RELATIVE_INT = 2, 6  # MAV_FRAME_MISSION, MAV_FRAME_
ItemFields = dict[str, float]


def waypoint_items(waypoints: Sequence[Waypoint]) -> list[ItemFields]:
    """The corners, and before each where the speed changes a word on that."""
    items, speed_mps = [], None
    for waypoint in waypoints:
        if waypoint.speed_mps != speed_mps:
            speed_mps = waypoint.speed_mps
            items.append(speed_item(speed_mps))
        items.append(waypoint_item(waypoint))
    return items


def landing_items(waypoints: Sequence[Waypoint]) -> list[ItemFields]:
    """The corners, the last of which is the ground to land on."""
    items = [waypoint_item(waypoint) for waypoint in waypoints]
    return [*items[:-1], {**items[-1], "command": LAND}]


def speed_item(speed_mps: float) -> ItemFields:
    """How fast to go on; PX4 takes it in the frame of no place alone."""
    return {
        "frame": FRAME_MISSION,
        "command": CHANGE_SPEED,
        "param1": GROUND_SPEED,
        "param2": speed_mps,
        "param3": SAME_THROTTLE,
    }


def waypoint_item(waypoint: Waypoint) -> ItemFields:
    """A place to fly through."""
    return {
        "frame": GLOBAL_RELATIVE_INT,
        "command": WAYPOINT,
        "x": round(waypoint.lat_deg * 1e7),
        "y": round(waypoint.lon_deg * 1e7),
        "z": waypoint.height_m,
    }
