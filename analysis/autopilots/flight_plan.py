"""What an autopilot is asked to fly: the scenario's mission as waypoints, or a hover; no I/O."""

import math
from dataclasses import dataclass

import numpy as np

from mavproxy_fault.numerics.earth import radii
from simvehicle.guidance.route import PathTrack
from simvehicle.simulation.simulation import Simulation

HEIGHTS_M = {"multirotor": 10.0, "fixedwing": 50.0}  # where no mission names one
CORNER_M = 20.0  # between the corners that a mission's path is flown by


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One corner of a mission, and how fast to fly to it."""

    lat_deg: float
    lon_deg: float
    height_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What is flown: up, along the corners (or nowhere), and after `duration_s` down."""

    height_m: float
    duration_s: float  # from leaving the ground
    waypoints: tuple[Waypoint, ...] = ()


def flight_plan(simulation: Simulation) -> FlightPlan:
    """The scenario's mission as corners of its path, or a hover where there is none."""
    scenario = simulation.scenario
    kind = scenario.vehicle.kind
    if not scenario.mission:
        return FlightPlan(HEIGHTS_M[kind], scenario.duration_s)
    track = simulation.controller.track
    assert isinstance(track, PathTrack)  # as a scenario with a mission has
    path = track.path
    every = max(round(CORNER_M / path.spacing_m), 1)
    lat_deg, lon_deg = scenario.start.lat_deg, scenario.start.lon_deg
    meridian_m, normal_m = (float(r) for r in radii(math.radians(lat_deg)))
    parallel_m = normal_m * math.cos(math.radians(lat_deg))
    waypoints = tuple(
        Waypoint(
            lat_deg + math.degrees(path.north_m[at] / meridian_m),
            lon_deg + math.degrees(path.east_m[at] / parallel_m),
            float(path.height_m[at]),
            float(path.speed_mps[at]),
        )
        for at in np.arange(0, len(path.north_m), every)
    )
    height_m = HEIGHTS_M[kind] if kind == "fixedwing" else waypoints[0].height_m
    return FlightPlan(height_m, scenario.duration_s, waypoints)
