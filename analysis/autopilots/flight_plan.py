"""What an autopilot is asked to fly: the scenario's mission as waypoints, or a hover; no I/O."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.earth import curvature_radii
from simvehicle.guidance.mission import MissionPath
from simvehicle.guidance.route import PathTrack
from simvehicle.scenario.scenario_file import StartConfig
from simvehicle.simulation.simulation import Simulation

DEFAULT_HEIGHTS_M = {"multirotor": 10.0, "fixedwing": 50.0}  # where no mission names one
WAYPOINT_SPACING_M = {
    "multirotor": 20.0,
    "fixedwing": 100.0,
}  # between those of a mission's path, at most
CHORD_TOLERANCE_M = {
    "multirotor": 1.0,
    "fixedwing": 5.0,
}  # by which the way between two may leave the path
APPROACH_LENGTH_M = 1000.0  # before the threshold a plane comes down straight from its height


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One corner of a mission, and how fast to fly to it."""

    lat_deg: float
    lon_deg: float
    height_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What is flown: up, along the corners (or nowhere), and after `duration_s` down; by what kind
    of vehicle, where it is to be checked."""

    height_m: float
    duration_s: float  # from leaving the ground
    waypoints: tuple[Waypoint, ...] = ()
    landing: tuple[Waypoint, ...] = ()  # a plane's way to the ground
    kind: str = ""


def flight_plan(simulation: Simulation) -> FlightPlan:
    """The scenario's mission as corners of its path, or a hover where there is none."""
    scenario = simulation.scenario
    kind = scenario.vehicle.kind
    height_m = DEFAULT_HEIGHTS_M[kind]
    landing = landing_approach(simulation, height_m) if kind == "fixedwing" else ()
    if not scenario.mission:
        return FlightPlan(height_m, scenario.duration_s, landing=landing, kind=kind)
    track = simulation.controller.track
    assert isinstance(track, PathTrack)  # as a scenario with a mission has
    path = track.path
    # An autopilot rounds its corners itself: more would only slow it down.
    waypoints = tuple(
        make_waypoint(
            scenario.start,
            (float(path.north_m[at]), float(path.east_m[at]), float(path.height_m[at])),
            float(path.speed_mps[at]),
        )
        for at in simplify_path(path, WAYPOINT_SPACING_M[kind], CHORD_TOLERANCE_M[kind])
    )
    if not landing:
        height_m = waypoints[0].height_m
    return FlightPlan(height_m, scenario.duration_s, waypoints, landing, kind)


def simplify_path(path: MissionPath, longest_m: float, chord_m: float) -> list[int]:
    """Points of a path by whose straight connections it is followed to within `chord_m`."""
    places = path.north_m + 1j * path.east_m
    most = max(round(longest_m / path.spacing_m), 1)
    chosen = [0]
    while (first := chosen[-1]) < len(places) - 1:
        last = min(first + most, len(places) - 1)
        # Shorter, until all that lies between is near enough to the chord.
        while last > first + 1 and _chord_deviation(places[first : last + 1]) > chord_m:
            last -= 1
        chosen.append(last)
    return chosen


def _chord_deviation(places: NDArray[np.complex128]) -> float:
    """How far points (n,) of the plane are from the chord of the first and last, at most."""
    chord = places[-1] - places[0]
    if abs(chord) == 0.0:
        return float(np.abs(places - places[0]).max())
    return float(np.abs(((places - places[0]) * chord.conjugate()).imag).max() / abs(chord))


def landing_approach(simulation: Simulation, height_m: float) -> tuple[Waypoint, ...]:
    """The way down to where the plane took off, and in the same direction."""
    start = simulation.scenario.start
    heading_rad = math.radians(start.heading_deg)
    north_m, east_m = (
        -APPROACH_LENGTH_M * math.cos(heading_rad),
        -APPROACH_LENGTH_M * math.sin(heading_rad),
    )
    speed_mps = simulation.vehicle.parameters.cruise_mps
    places = ((north_m, east_m, height_m), (0.0, 0.0, 0.0))
    return tuple(make_waypoint(start, place, speed_mps) for place in places)


def make_waypoint(
    start: StartConfig, place_m: tuple[float, float, float], speed_mps: float
) -> Waypoint:
    """A place north, east and above of the start."""
    north_m, east_m, height_m = place_m
    meridian_m, normal_m = (float(r) for r in curvature_radii(math.radians(start.lat_deg)))
    parallel_m = normal_m * math.cos(math.radians(start.lat_deg))
    return Waypoint(
        start.lat_deg + math.degrees(north_m / meridian_m),
        start.lon_deg + math.degrees(east_m / parallel_m),
        height_m,
        speed_mps,
    )
