"""A mission path as waypoints, for an autopilot or a ground station."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.earth import curvature_radii
from simvehicle.guidance.mission import MissionPath
from simvehicle.scenario.scenario_file import StartConfig

# Longest leg, and largest distance between a leg and the path that it replaces [m]. A plane flies
# past its corners; all others stop at them, so more of them would only slow these down.
MULTIROTOR_LEGS_M = (20.0, 1.0)
FIXED_WING_LEGS_M = (100.0, 5.0)


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A waypoint of a mission, with the speed of the leg to it."""

    lat_deg: float
    lon_deg: float
    height_m: float
    speed_mps: float


def path_waypoints(path: MissionPath, start: StartConfig, kind: str) -> tuple[Waypoint, ...]:
    """The waypoints of a path for this kind of vehicle; other kinds get a multirotor's."""
    legs_m = FIXED_WING_LEGS_M if kind == "fixedwing" else MULTIROTOR_LEGS_M
    indices = simplify_path(path, *legs_m)
    return tuple(
        make_waypoint(
            start,
            (float(path.north_m[at]), float(path.east_m[at]), float(path.height_m[at])),
            float(path.speed_mps[at]),
        )
        for at in indices
    )


def simplify_path(path: MissionPath, longest_m: float, chord_m: float) -> list[int]:
    """Indices of points whose straight connections stay within `chord_m` of the path."""
    points = path.north_m + 1j * path.east_m
    max_points = max(round(longest_m / path.spacing_m), 1)
    chosen = [0]
    while (first := chosen[-1]) < len(points) - 1:
        last = min(first + max_points, len(points) - 1)
        # Shorten the leg until every point between its ends is close enough to the chord.
        while last > first + 1 and _chord_deviation(points[first : last + 1]) > chord_m:
            last -= 1
        chosen.append(last)
    return chosen


def _chord_deviation(points: NDArray[np.complex128]) -> float:
    """Largest distance [m] of points (n,), as complex numbers, from the chord of their ends."""
    chord = points[-1] - points[0]
    if abs(chord) == 0.0:
        return float(np.abs(points - points[0]).max())
    return float(np.abs(((points - points[0]) * chord.conjugate()).imag).max() / abs(chord))


def make_waypoint(
    start: StartConfig, position_m: tuple[float, float, float], speed_mps: float
) -> Waypoint:
    """A waypoint at `position_m`: north, east and above the start [m]."""
    north_m, east_m, height_m = position_m
    meridian_m, normal_m = (float(r) for r in curvature_radii(math.radians(start.lat_deg)))
    parallel_m = normal_m * math.cos(math.radians(start.lat_deg))
    return Waypoint(
        start.lat_deg + math.degrees(north_m / meridian_m),
        start.lon_deg + math.degrees(east_m / parallel_m),
        height_m,
        speed_mps,
    )
