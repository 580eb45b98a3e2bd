"""Flight plan of an autopilot: the scenario's mission as waypoints, or a hover; no I/O."""

import math
from dataclasses import dataclass

from simvehicle.guidance.route import PathTrack
from simvehicle.guidance.waypoints import Waypoint, make_waypoint, path_waypoints
from simvehicle.simulation.simulation import Simulation

DEFAULT_HEIGHTS_M = {"multirotor": 10.0, "fixedwing": 50.0}  # without a mission
APPROACH_LENGTH_M = 1000.0  # length of the straight descent to the runway threshold


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """Take off, fly the waypoints (or hover), and land after `duration_s`; `kind` is the expected
    vehicle, empty if not checked."""

    height_m: float
    duration_s: float  # from take-off
    waypoints: tuple[Waypoint, ...] = ()
    landing: tuple[Waypoint, ...] = ()  # the landing approach of a plane
    kind: str = ""


def flight_plan(simulation: Simulation) -> FlightPlan:
    """Convert the scenario's mission to waypoints, or return a hover if there is none."""
    scenario = simulation.scenario
    kind = scenario.vehicle.kind
    height_m = DEFAULT_HEIGHTS_M[kind]
    landing = landing_approach(simulation, height_m) if kind == "fixedwing" else ()
    if not scenario.mission:
        return FlightPlan(height_m, scenario.duration_s, landing=landing, kind=kind)
    track = simulation.controller.track
    assert isinstance(track, PathTrack)  # true for every scenario with a mission
    waypoints = path_waypoints(track.path, scenario.start, kind)
    if not landing:
        height_m = waypoints[0].height_m
    return FlightPlan(height_m, scenario.duration_s, waypoints, landing, kind)


def landing_approach(simulation: Simulation, height_m: float) -> tuple[Waypoint, ...]:
    """Plan the approach to the place of the take-off, in the same direction."""
    start = simulation.scenario.start
    heading_rad = math.radians(start.heading_deg)
    north_m, east_m = (
        -APPROACH_LENGTH_M * math.cos(heading_rad),
        -APPROACH_LENGTH_M * math.sin(heading_rad),
    )
    speed_mps = simulation.vehicle.parameters.cruise_mps
    points = ((north_m, east_m, height_m), (0.0, 0.0, 0.0))
    return tuple(make_waypoint(start, point, speed_mps) for point in points)
