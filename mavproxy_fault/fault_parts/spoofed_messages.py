"""Moves the position and velocity of each message that carries them, in metres NED."""

import math
from collections.abc import Callable, Sequence
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


class GeodeticFields(NamedTuple):
    """Fields beside `lat` and `lon`: counts per metre, altitudes, velocities, counts per m/s."""

    per_m: float
    altitudes: tuple[str, ...]
    velocities: tuple[str, ...] = ()
    per_mps: float = 1.0


GEODETIC = {
    "HIL_GPS": GeodeticFields(1000.0, ("alt",), ("vn", "ve", "vd"), 100.0),
    "GPS_RAW_INT": GeodeticFields(1000.0, ("alt", "alt_ellipsoid")),
    "GPS2_RAW": GeodeticFields(1000.0, ("alt", "alt_ellipsoid")),
    "GPS_INPUT": GeodeticFields(1.0, ("alt",), ("vn", "ve", "vd")),
    "GLOBAL_POSITION_INT": GeodeticFields(
        1000.0, ("alt", "relative_alt"), ("vx", "vy", "vz"), 100.0
    ),
}


def move_geodetic(frame: Frame, move: Move) -> dict[str, Number]:
    """Move a message with latitude and longitude in degE7, its velocity, speed and course."""
    fields = GEODETIC[frame.layout.name]
    lat, lon, alt = frame.number("lat"), frame.number("lon"), frame.number("alt")
    # The altitude of GPS_INPUT may be NaN.
    alt_m = alt / fields.per_m if math.isfinite(alt) else 0.0
    dlat, dlon = moved_degrees(lat * 1e-7, alt_m, move.offset_m)
    # Longitude wraps at 180 degrees.
    turned = (lon * 1e-7 + dlon + 180.0) % 360.0 - 180.0
    values = {
        "lat": lat + round(dlat * 1e7),
        # Added in integer counts unless it wraps, to keep all digits of the healthy value.
        "lon": lon + round(dlon * 1e7) if -180.0 <= lon * 1e-7 + dlon < 180.0 else turned * 1e7,
    }
    for name in fields.altitudes:
        # An ellipsoidal height of 0 is unknown.
        if name in frame.layout.fields and (name != "alt_ellipsoid" or frame.number(name)):
            values[name] = frame.number(name) - move.offset_m[2] * fields.per_m
    # Without a velocity offset, the velocity fields stay byte for byte.
    if any(move.velocity_mps):
        change = tuple(one * fields.per_mps for one in move.velocity_mps)
        values |= _added(frame, fields.velocities, change) | _moved_ground_speed(frame, move)
    return values


def _moved_ground_speed(frame: Frame, move: Move) -> dict[str, Number]:
    """Return `vel` [cm/s] and `cog` [cdeg] of a message that has them, as far as they are known."""
    north_mps, east_mps, _ = move.velocity_mps
    if "cog" not in frame.layout.fields or not (north_mps or east_mps):
        return {}
    known = {name for name in ("vel", "cog") if frame.number(name) != UNKNOWN_U16}
    if "vn" in frame.layout.fields:
        vn, ve = frame.number("vn") / 100.0, frame.number("ve") / 100.0
    elif len(known) == 2:
        speed_mps, course = frame.number("vel") / 100.0, math.radians(frame.number("cog") / 100.0)
        vn, ve = speed_mps * math.cos(course), speed_mps * math.sin(course)
    else:
        return {}
    vn, ve = vn + north_mps, ve + east_mps
    course_deg = math.degrees(math.atan2(ve, vn)) % 360.0
    moved = {"vel": math.hypot(vn, ve) * 100.0, "cog": round(course_deg * 100.0) % 36000}
    return {name: value for name, value in moved.items() if name in known}


def move_local_position(frame: Frame, move: Move) -> dict[str, Number]:
    """Move LOCAL_POSITION_NED."""
    names = ("x", "y", "z", "vx", "vy", "vz")
    return _added(frame, names, (*move.offset_m, *move.velocity_mps))


def move_odometry(frame: Frame, move: Move) -> dict[str, Number]:
    """Move ODOMETRY: position in a local NED or ENU frame, velocity in it or in body axes.

    Frames of reference of unknown heading are not moved, since north is undefined in them, nor are
    estimators without GNSS.
    """
    local, child = frame.number("frame_id"), frame.number("child_frame_id")
    if local not in (LOCAL_NED, LOCAL_ENU) or frame.number("estimator_type") in WITHOUT_SATELLITES:
        return {}
    # Convert to the axes of the message.
    offset, velocity = move.offset_m, move.velocity_mps
    if local == LOCAL_ENU:
        offset, velocity = _enu(offset), _enu(velocity)
    values = _added(frame, ("x", "y", "z"), offset)
    # The velocity is in the child frame: body, local, or one without a known rotation.
    if child == BODY_FRD:
        q_nb = [float(frame.number("q", i)) for i in range(4)]
        velocity = rotate_to_body(q_nb, velocity)
    elif child != local:
        return values
    return values | _added(frame, ("vx", "vy", "vz"), velocity)


def _added(frame: Frame, names: Sequence[str], change: Sequence[float]) -> dict[str, Number]:
    return {name: frame.number(name) + c for name, c in zip(names, change, strict=False)}


def _enu(ned: Three) -> Three:
    # East, north, up.
    return ned[1], ned[0], -ned[2]


MOVERS: dict[str, Callable[[Frame, Move], dict[str, Number]]] = {
    **dict.fromkeys(GEODETIC, move_geodetic),
    "LOCAL_POSITION_NED": move_local_position,
    "ODOMETRY": move_odometry,
}
