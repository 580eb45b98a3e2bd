"""Moves the position and velocity of each message that carries them, in metres NED."""

import math
from collections.abc import Callable
from typing import NamedTuple

from mavproxy_fault.numerics.constants import WGS84_ECCENTRICITY2, WGS84_SEMI_MAJOR_M
from mavproxy_fault.numerics.rotations.one_rotation import rotate_to_body
from mavproxy_fault.wire.frame import Frame, Number

Three = tuple[float, float, float]

UNKNOWN_U16 = 0xFFFF
LOCAL_NED, LOCAL_ENU, BODY_FRD = 1, 4, 12  # MAV_FRAME
# MAV_ESTIMATOR_TYPE: vision, visual-inertial, motion capture, lidar, which use no GNSS.
WITHOUT_SATELLITES = (2, 3, 6, 7)


class Move(NamedTuple):
    """Offsets of position and velocity, NED."""

    offset_m: Three
    velocity_mps: Three


def moved_degrees(lat_deg: float, alt_m: float, offset_m: Three) -> tuple[float, float]:
    """Convert an offset [m, NED] to degrees of latitude and longitude."""
    lat = math.radians(lat_deg)
    # Radii of curvature in the prime vertical and in the meridian.
    w2 = 1.0 - WGS84_ECCENTRICITY2 * math.sin(lat) ** 2
    east_radius_m = WGS84_SEMI_MAJOR_M / math.sqrt(w2)
    north_radius_m = east_radius_m * (1.0 - WGS84_ECCENTRICITY2) / w2
    north, east, _ = offset_m
    return (
        math.degrees(north / (north_radius_m + alt_m)),
        # Bounded, to avoid a division by zero at the poles.
        math.degrees(east / ((east_radius_m + alt_m) * max(math.cos(lat), 1e-6))),
    )


def move_position(frame: Frame, move: Move, alt_scale: float) -> dict[str, Number]:
    """Return the moved `lat`, `lon` (degE7) and `alt` (`alt_scale` counts per metre)."""
    lat, lon, alt = frame.number("lat"), frame.number("lon"), frame.number("alt")
    # The altitude of GPS_INPUT may be NaN.
    alt_m = alt / alt_scale if math.isfinite(alt) else 0.0
    dlat, dlon = moved_degrees(lat * 1e-7, alt_m, move.offset_m)
    # Longitude wraps at 180 degrees.
    turned = (lon * 1e-7 + dlon + 180.0) % 360.0 - 180.0
    return {
        "lat": lat + round(dlat * 1e7),
        # Added in integer counts unless it wraps, to keep all digits of the healthy value.
        "lon": lon + round(dlon * 1e7) if -180.0 <= lon * 1e-7 + dlon < 180.0 else turned * 1e7,
        "alt": alt - move.offset_m[2] * alt_scale,
    }


def ground_speed(vn: float, ve: float) -> dict[str, Number]:
    """Return `vel` [cm/s] and `cog` [cdeg] of a velocity [m/s]."""
    course = math.degrees(math.atan2(ve, vn)) % 360.0
    return {"vel": math.hypot(vn, ve) * 100.0, "cog": round(course * 100.0) % 36000}


def move_hil_gps(frame: Frame, move: Move) -> dict[str, Number]:
    """Move HIL_GPS: velocity in cm/s, with ground speed and course where they are known."""
    values = move_position(frame, move, 1000.0)
    # Without a velocity offset, the velocity fields stay byte for byte.
    if not any(move.velocity_mps):
        return values
    old = [frame.number(name) / 100.0 for name in ("vn", "ve", "vd")]
    new = [v + dv for v, dv in zip(old, move.velocity_mps, strict=True)]
    speed = ground_speed(new[0], new[1])
    values |= {"vn": new[0] * 100.0, "ve": new[1] * 100.0, "vd": new[2] * 100.0}
    # Unknown speed and course stay unknown.
    return values | {k: v for k, v in speed.items() if frame.number(k) != UNKNOWN_U16}


def move_gps_raw(frame: Frame, move: Move) -> dict[str, Number]:
    """Move GPS_RAW_INT or GPS2_RAW, with velocity as ground speed and course."""
    values = move_position(frame, move, 1000.0)
    if "alt_ellipsoid" in frame.layout.fields and frame.number("alt_ellipsoid"):
        values["alt_ellipsoid"] = frame.number("alt_ellipsoid") - move.offset_m[2] * 1000.0
    vel, cog = frame.number("vel"), frame.number("cog")
    # Unknown speed or course stay unknown; a vertical offset changes neither.
    if UNKNOWN_U16 in (vel, cog) or not any(move.velocity_mps[:2]):
        return values
    course = math.radians(cog / 100.0)
    vn = vel / 100.0 * math.cos(course) + move.velocity_mps[0]
    ve = vel / 100.0 * math.sin(course) + move.velocity_mps[1]
    return values | ground_speed(vn, ve)


def move_gps_input(frame: Frame, move: Move) -> dict[str, Number]:
    """Move GPS_INPUT, in m and m/s."""
    values = move_position(frame, move, 1.0)
    for name, change in zip(("vn", "ve", "vd"), move.velocity_mps, strict=True):
        values[name] = frame.number(name) + change
    return values


def move_global_position(frame: Frame, move: Move) -> dict[str, Number]:
    """Move GLOBAL_POSITION_INT: both altitudes in mm, velocity in cm/s."""
    values = move_position(frame, move, 1000.0)
    values["relative_alt"] = frame.number("relative_alt") - move.offset_m[2] * 1000.0
    for name, change in zip(("vx", "vy", "vz"), move.velocity_mps, strict=True):
        values[name] = frame.number(name) + change * 100.0
    return values


def move_local_position(frame: Frame, move: Move) -> dict[str, Number]:
    """Move LOCAL_POSITION_NED."""
    changes = (*move.offset_m, *move.velocity_mps)
    names = ("x", "y", "z", "vx", "vy", "vz")
    return {name: frame.number(name) + c for name, c in zip(names, changes, strict=True)}


def move_odometry(frame: Frame, move: Move) -> dict[str, Number]:
    """Move ODOMETRY: position in a local NED or ENU frame, velocity in it or in body axes.

    Frames of reference of unknown heading are not moved, since north is undefined in them, nor are
    estimators without GNSS.
    """
    local, child = frame.number("frame_id"), frame.number("child_frame_id")
    if local not in (LOCAL_NED, LOCAL_ENU) or frame.number("estimator_type") in WITHOUT_SATELLITES:
        return {}
    # Convert to the axes of the message.
    axes = _enu if local == LOCAL_ENU else _same
    values = _added(frame, ("x", "y", "z"), axes(move.offset_m))
    velocity = axes(move.velocity_mps)
    # The velocity is in the child frame: body, local, or one without a known rotation.
    if child == BODY_FRD:
        q_nb = [float(frame.number("q", i)) for i in range(4)]
        velocity = rotate_to_body(q_nb, velocity)
    elif child != local:
        return values
    return values | _added(frame, ("vx", "vy", "vz"), velocity)


def _added(frame: Frame, names: tuple[str, str, str], change: Three) -> dict[str, Number]:
    return {name: frame.number(name) + c for name, c in zip(names, change, strict=True)}


def _same(ned: Three) -> Three:
    return ned


def _enu(ned: Three) -> Three:
    # East, north, up.
    return ned[1], ned[0], -ned[2]


MOVERS: dict[str, Callable[[Frame, Move], dict[str, Number]]] = {
    "HIL_GPS": move_hil_gps,
    "GPS_RAW_INT": move_gps_raw,
    "GPS2_RAW": move_gps_raw,
    "GPS_INPUT": move_gps_input,
    "GLOBAL_POSITION_INT": move_global_position,
    "LOCAL_POSITION_NED": move_local_position,
    "ODOMETRY": move_odometry,
}
