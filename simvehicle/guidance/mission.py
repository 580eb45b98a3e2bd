"""Missions by shape: paths of straights and arcs over the ground.

Every shape starts and ends with the same heading, and the closed ones (triangle, diamond,
trapezoid, circle, eight) at the same position, so legs join without a jump. Corners are rounded
with a radius that the vehicle can fly. `size_m` is the side of a triangle or diamond, the long base
of a trapezoid, the diameter of a circle, the length of an eight or a line, and the straights of an
S.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.arrays import Array
from simvehicle.scenario.scenario_file import Leg

Arc = tuple[float, float]
"""Length [m] and curvature [1/m] (positive turns right)."""


@dataclass(frozen=True, slots=True)
class MissionPath:
    """Points along a path, a fixed distance apart; all arrays have shape (n,).

    Position north and east of home [m], course [rad], curvature [1/m] (positive to the right),
    height above home [m], speed [m/s] and the number of the mission's leg.
    """

    north_m: Array
    east_m: Array
    course_rad: Array
    curvature_pm: Array
    height_m: Array
    speed_mps: Array
    leg: NDArray[np.int64]
    spacing_m: float


def straight_arc(length_m: float) -> Arc:
    """A straight segment."""
    return length_m, 0.0


def turn_arc(radius_m: float, angle_deg: float) -> Arc:
    """An arc to the right (or to the left, for a negative angle)."""
    return radius_m * math.radians(abs(angle_deg)), math.copysign(1.0 / radius_m, angle_deg)


def _polygon_arcs(
    sides_m: Sequence[float], turns_deg: Sequence[float], radius_m: float
) -> list[Arc]:
    """A closed polygon with rounded corners, from the middle of its first side."""
    cuts = [radius_m * math.tan(math.radians(angle) / 2.0) for angle in turns_deg]
    arcs = [straight_arc(sides_m[0] / 2.0 - cuts[0])]
    for index, angle in enumerate(turns_deg):
        following = (index + 1) % len(sides_m)
        length = sides_m[following] - cuts[index]
        if following == 0:
            length -= sides_m[0] / 2.0
        else:
            length -= cuts[index + 1]
        arcs += [turn_arc(radius_m, angle), straight_arc(length)]
    return arcs


def lap_arcs(shape: str, size_m: float, radius_m: float) -> list[Arc]:
    """One lap of a shape; an arc has negative length where the corners do not fit."""
    a = size_m
    match shape:
        case "line":
            return [straight_arc(a)]
        case "circle":
            return [turn_arc(a / 2.0, 360.0)]
        case "eight":
            lobe = a / 6.0  # two circles two diameters apart, joined by their crossing tangents
            run = math.sqrt(3.0) * lobe
            arc = 240.0
            return [
                *(straight_arc(run), turn_arc(lobe, arc), straight_arc(2.0 * run)),
                *(turn_arc(lobe, -arc), straight_arc(run)),
            ]
        case "s":
            bend = max(radius_m, a / 4.0)
            return [straight_arc(a), turn_arc(bend, 180.0), straight_arc(a), turn_arc(bend, -180.0)]
        case "triangle":
            return _polygon_arcs([a, a, a], [120.0, 120.0, 120.0], radius_m)
        case "diamond":
            return _polygon_arcs([a, a, a, a], [60.0, 120.0, 60.0, 120.0], radius_m)
        case "trapezoid":
            half = a / 2.0
            return _polygon_arcs([a, half, half, half], [120.0, 60.0, 60.0, 120.0], radius_m)
    raise ValueError(f"unknown shape {shape}")


def smallest_size(shape: str, radius_m: float) -> float:
    """Smallest `size_m` of a shape whose corners have this radius [m]."""
    # A rounded corner shortens both sides by the radius times the tangent of half its turn.
    corner = math.tan(math.radians(60.0))
    blunt = math.tan(math.radians(30.0))
    return radius_m * {
        "line": 0.0,
        "circle": 2.0,
        "eight": 6.0,
        "s": 0.0,
        "triangle": 2.0 * corner,
        "diamond": 2.0 * corner,
        "trapezoid": 2.0 * (corner + blunt),
    }.get(shape, 0.0)


def turn_radius(speed_mps: float, wind_mps: float, acceleration_mps2: float) -> float:
    """Radius [m] of a downwind turn at a lateral acceleration."""
    return (speed_mps + wind_mps) ** 2 / acceleration_mps2


def plan_path(
    legs: Sequence[Leg],
    start: tuple[float, float, float],
    cruise_mps: float,
    wind_mps: float,
    acceleration_mps2: float,
) -> MissionPath:
    """Plan the path of a mission, one leg after the other.

    Parameters
    ----------
    legs : sequence of Leg
    start : 3 floats
        North, east [m] and course [rad] of the first point.
    cruise_mps : float
        Speed of the legs without `speed_mps`.
    wind_mps, acceleration_mps2 : float
        Wind speed and lateral acceleration that determine the corner radius.

    Raises
    ------
    ConfigError
        If a shape is too small to fly.
    """
    arcs: list[tuple[float, float, float, float, int]] = []
    spacing = 5.0
    for number, leg in enumerate(legs):
        speed = leg.speed_mps or cruise_mps
        radius = turn_radius(speed, wind_mps, acceleration_mps2)
        smallest = smallest_size(leg.shape, radius)
        if leg.size_m < smallest:
            raise ConfigError(
                f"mission[{number}].size_m = {leg.size_m:g} is too small for a {leg.shape} at "
                f"{speed:g} m/s in {wind_mps:.1f} m/s of wind; use at least {math.ceil(smallest)}"
            )
        spacing = min(spacing, 0.1 * speed + 0.2)
        for length, curvature in lap_arcs(leg.shape, leg.size_m, radius) * leg.laps:
            if length > 0.0:
                arcs.append((length, curvature, leg.height_m, speed, number))
    return _sample_arcs(arcs, start, spacing)


def _sample_arcs(
    arcs: Sequence[tuple[float, float, float, float, int]],
    start: tuple[float, float, float],
    spacing_m: float,
) -> MissionPath:
    """Sample the arcs at fixed spacing; positions are exact (closed-form integration)."""
    ends = np.cumsum([0.0] + [arc[0] for arc in arcs])
    s = np.arange(0.0, ends[-1] + spacing_m, spacing_m)
    index = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, len(arcs) - 1)
    _, curvature, height, speed, leg = (np.array(column) for column in zip(*arcs, strict=True))
    north, east, course = start
    origins = []
    for length, bend, *_ in arcs:
        origins.append((north, east, course))
        dn, de = _arc_displacement(np.array(length), np.array(bend), np.array(course))
        north, east, course = north + float(dn), east + float(de), course + bend * length
    first = np.array(origins)[index]
    run = s - ends[index]
    dn, de = _arc_displacement(run, curvature[index], first[:, 2])
    return MissionPath(
        first[:, 0] + dn,
        first[:, 1] + de,
        first[:, 2] + curvature[index] * run,
        curvature[index],
        height[index],
        speed[index],
        leg[index].astype(np.int64),
        spacing_m,
    )


def _arc_displacement(run: Array, bend: Array, course: Array) -> tuple[Array, Array]:
    """North and east displacement over `run` metres of constant curvature."""
    half = 0.5 * bend * run
    # numpy's sinc(x) is sin(pi x) / (pi x), so straights need no special case.
    chord = run * np.sinc(half / np.pi)
    return np.asarray(chord * np.cos(course + half)), np.asarray(chord * np.sin(course + half))
