"""Tracks: paths and points to fly, as guidance setpoints at the vehicle's position.

A track gives course, cross-track error and curvature; the controllers of all vehicles use them.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simvehicle.guidance.mission import MissionPath

_SEARCH_POINTS = 400  # chosen: points ahead among which the nearest is searched; 2 km at 5 m
_BRAKING_MPS2 = 1.5  # chosen: half the multirotor's lateral acceleration


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Setpoint of a track for the controller.

    Course over ground [rad], cross-track error [m] (positive right of the track), curvature a
    little ahead [1/m], height above home [m], speed [m/s] and the remaining distance [m], infinite
    for a track without an end.
    """

    course_rad: float
    cross_track_m: float
    curvature_pm: float
    height_m: float
    speed_mps: float
    distance_m: float = math.inf


class GuidanceTrack(Protocol):
    """A track to follow; `setpoint_from` may store the progress of the vehicle."""

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> Setpoint:
        """The setpoint at a position; `ahead_m` is the look-ahead of the curvature."""


class PathTrack:
    """Follows a planned path from its first point to its last."""

    def __init__(self, path: MissionPath) -> None:
        self.path = path
        self.index = 0
        columns = (path.north_m, path.east_m, path.course_rad, path.curvature_pm)
        self._points = np.column_stack([*columns, path.height_m, path.speed_mps]).tolist()

    @property
    def leg(self) -> int:
        """Number of the current mission leg."""
        return int(self.path.leg[self.index])

    @property
    def finished(self) -> bool:
        """Whether the last point is reached."""
        return self.index >= len(self._points) - 1

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> Setpoint:
        """The setpoint at the path point beside the vehicle; progress never goes back."""
        last = len(self._points) - 1
        for i in range(self.index, min(self.index + _SEARCH_POINTS, last) + 1):
            north, east, course, bend, height, speed = self._points[i]
            dn, de = north_m - north, east_m - east
            along = dn * math.cos(course) + de * math.sin(course)
            if along < self.path.spacing_m:
                break
        self.index = i
        # The path deviates from its tangent by half the curvature times the distance squared.
        error = -dn * math.sin(course) + de * math.cos(course) - 0.5 * bend * along * along
        j = min(last, i + round(ahead_m / self.path.spacing_m))
        return Setpoint(course + bend * along, error, self._points[j][3], height, speed)


@dataclass(slots=True)
class CircleTrack:
    """Circles a point clockwise, without end."""

    north_m: float
    east_m: float
    height_m: float
    radius_m: float
    speed_mps: float

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> Setpoint:
        """The setpoint along the circle's tangent beside the vehicle."""
        dn, de = north_m - self.north_m, east_m - self.east_m
        bearing = math.atan2(de, dn)
        # The centre of a clockwise circle is to the right, so outside is left of the track.
        error = self.radius_m - math.hypot(dn, de)
        return Setpoint(
            bearing + 0.5 * math.pi, error, 1.0 / self.radius_m, self.height_m, self.speed_mps
        )


@dataclass(frozen=True, slots=True)
class HoldTrack:
    """Flies straight to a point and stays there."""

    north_m: float
    east_m: float
    height_m: float
    speed_mps: float

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> Setpoint:
        """The setpoint towards the point, with decreasing speed."""
        dn, de = self.north_m - north_m, self.east_m - east_m
        distance = math.hypot(dn, de)
        # Within 3 m the braking law is too steep to follow: use a speed linear in the distance.
        speed = min(self.speed_mps, math.sqrt(2.0 * _BRAKING_MPS2 * distance), distance)
        return Setpoint(math.atan2(de, dn), 0.0, 0.0, self.height_m, speed, distance)
