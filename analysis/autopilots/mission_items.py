"""Convert waypoints to mission items, the fields of MISSION_ITEM_INT; no I/O."""

from collections.abc import Sequence

from simvehicle.guidance.waypoints import Waypoint

WAYPOINT, LAND = 16, 21  # MAV_CMD_NAV_
CHANGE_SPEED, GROUND_SPEED, SAME_THROTTLE = 178, 1, -1  # MAV_CMD_DO_CHANGE_SPEED
FRAME_MISSION, GLOBAL_RELATIVE_INT = 2, 6  # MAV_FRAME_MISSION, MAV_FRAME_
ItemFields = dict[str, float]


def waypoint_items(waypoints: Sequence[Waypoint]) -> list[ItemFields]:
    """Return the items of a mission, with a speed command before each change of speed."""
    items, speed_mps = [], None
    for waypoint in waypoints:
        if waypoint.speed_mps != speed_mps:
            speed_mps = waypoint.speed_mps
            items.append(speed_item(speed_mps))
        items.append(waypoint_item(waypoint))
    return items


def landing_items(waypoints: Sequence[Waypoint]) -> list[ItemFields]:
    """Return the items of a landing, the last of which is LAND."""
    items = [waypoint_item(waypoint) for waypoint in waypoints]
    return [*items[:-1], {**items[-1], "command": LAND}]


def speed_item(speed_mps: float) -> ItemFields:
    """Return a DO_CHANGE_SPEED item; PX4 accepts it in MAV_FRAME_MISSION only."""
    return {
        "frame": FRAME_MISSION,
        "command": CHANGE_SPEED,
        "param1": GROUND_SPEED,
        "param2": speed_mps,
        "param3": SAME_THROTTLE,
    }


def waypoint_item(waypoint: Waypoint) -> ItemFields:
    """Return a waypoint item."""
    return {
        "frame": GLOBAL_RELATIVE_INT,
        "command": WAYPOINT,
        "x": round(waypoint.lat_deg * 1e7),
        "y": round(waypoint.lon_deg * 1e7),
        "z": waypoint.height_m,
    }
