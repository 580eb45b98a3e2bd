"""Where to fly next: a path or a point, seen from where the vehicle is.

A track answers with the course, cross-track error and curvature to steer by; both vehicles'
controllers use the same answer.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from simvehicle.guidance.mission import MissionPath

_SEARCH_POINTS = 400  # points searched ahead for the nearest one
_BRAKING_MPS2 = 1.5


@dataclass(frozen=True, slots=True)
class GuidanceSetpoint:
    """What a track asks for.

    Course over ground [rad], cross-track error [m] (positive right of the track), curvature
    a little ahead [1/m], height above home [m], speed [m/s] and the distance to go to the place
    where the track ends, infinite for tracks that do not end.
    """

    course_rad: float
    cross_track_m: float
    curvature_pm: float
    height_m: float
    speed_mps: float
    distance_m: float = math.inf


class GuidanceTrack(Protocol):
    """Something to follow; `setpoint_from` may remember how far the vehicle has come."""

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> GuidanceSetpoint:
        """Aim from a position; `ahead_m` is how far the curvature is read in advance."""


class PathTrack:
    """Follows a planned path from its first point to its last."""

    def __init__(self, path: MissionPath) -> None:
        self.path = path
        self.index = 0
        self._north = path.north_m.tolist()
        self._east = path.east_m.tolist()
        self._course = path.course_rad.tolist()
        self._curvature = path.curvature_pm.tolist()
        self._height = path.height_m.tolist()
        self._speed = path.speed_mps.tolist()

    @property
    def leg(self) -> int:
        """Number of the mission's leg now flown."""
        return int(self.path.leg[self.index])

    @property
    def finished(self) -> bool:
        """Whether the last point is reached."""
        return self.index >= len(self._north) - 1

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> GuidanceSetpoint:
        """Aim at the path beside the vehicle; progress only goes forward."""
        i, last = self.index, len(self._north) - 1
        for _ in range(_SEARCH_POINTS):
            along = (north_m - self._north[i]) * math.cos(self._course[i]) + (
                east_m - self._east[i]
            ) * math.sin(self._course[i])
            if along < self.path.spacing_m or i >= last:
                break
            i += 1
        self.index = i
        course = self._course[i]
        dn, de = north_m - self._north[i], east_m - self._east[i]
        along = dn * math.cos(course) + de * math.sin(course)
        bend = self._curvature[i]
        # The path curves away from its tangent by half the curvature times the run squared.
        error = -dn * math.sin(course) + de * math.cos(course) - 0.5 * bend * along * along
        j = min(last, i + round(ahead_m / self.path.spacing_m))
        return GuidanceSetpoint(
            course + bend * along,
            error,
            self._curvature[j],
            self._height[i],
            self._speed[i],
        )


class CircleTrack:
    """Circles a point to the right for ever."""

    def __init__(
        self, north_m: float, east_m: float, height_m: float, radius_m: float, speed_mps: float
    ) -> None:
        self.north_m, self.east_m, self.height_m = north_m, east_m, height_m
        self.radius_m, self.speed_mps = radius_m, speed_mps

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> GuidanceSetpoint:
        """Aim along the circle's tangent beside the vehicle."""
        dn, de = north_m - self.north_m, east_m - self.east_m
        bearing = math.atan2(de, dn)
        # Flying clockwise the centre lies to the right, so outside is left of the track.
        error = self.radius_m - math.hypot(dn, de)
        return GuidanceSetpoint(
            bearing + 0.5 * math.pi, error, 1.0 / self.radius_m, self.height_m, self.speed_mps
        )


class HoldTrack:
    """Goes straight to a point and stays there."""

    def __init__(self, north_m: float, east_m: float, height_m: float, speed_mps: float) -> None:
        self.north_m, self.east_m, self.height_m = north_m, east_m, height_m
        self.speed_mps = speed_mps
        self.radius_m = speed_mps**2 / (2.0 * _BRAKING_MPS2)  # where it begins to slow down

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> GuidanceSetpoint:
        """Aim at the point, slower and slower."""
        dn, de = self.north_m - north_m, self.east_m - east_m
        distance = math.hypot(dn, de)
        # Within 3 m the braking law gets too steep to follow: the speed goes with the distance.
        speed = min(self.speed_mps, math.sqrt(2.0 * _BRAKING_MPS2 * distance), distance)
        return GuidanceSetpoint(math.atan2(de, dn), 0.0, 0.0, self.height_m, speed, distance)
