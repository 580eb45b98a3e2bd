"""The vehicle flown by its own controller to the goals of a `CommandedFlight`."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from simvehicle.autopilot.flight_goals import CommandedFlight, Goal, GoalKind
from simvehicle.guidance.route import CircleTrack, GuidanceSetpoint, GuidanceTrack
from simvehicle.vehicles.body import Controls


@dataclass(frozen=True)
class Approach:
    """A straight course to a waiting place, then whatever waits there.

    Without it a vehicle that circles would join a far circle by a wide spiral.
    """

    north_m: float
    east_m: float
    near_m: float
    waiting_track: GuidanceTrack

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> GuidanceSetpoint:
        """Aim at the place from afar."""
        # Height and speed are those of the waiting place from the start.
        aim = self.waiting_track.setpoint_from(north_m, east_m, ahead_m)
        dn, de = self.north_m - north_m, self.east_m - east_m
        if math.hypot(dn, de) < self.near_m:
            return aim
        return GuidanceSetpoint(math.atan2(de, dn), 0.0, 0.0, aim.height_m, aim.speed_mps)


class Pilot:
    """Turns the goal of the moment into controls, or into a track for the built-in controller."""

    def __init__(self, simulation: Any, flight: CommandedFlight) -> None:
        self._simulation = simulation
        self.flight = flight
        self._goal: Goal | None = None
        # As many actuators as the vehicle has, all off.
        self._idle = Controls(np.zeros(simulation.vehicle.controls_count), armed=False)

    def controls(self) -> Controls | None:
        """Actuators off on the ground; None where the built-in controller flies."""
        goal = self.flight.goal
        if goal.kind is GoalKind.IDLE:
            self._goal = None
            return self._idle
        # By identity: an equal goal that was set anew is followed anew.
        if goal is not self._goal:
            self._goal = goal
            self._follow(goal)
        return None

    def _follow(self, goal: Goal) -> None:
        controller = self._simulation.controller
        north, east, down = goal.r_ned_m.tolist()
        # Without a speed of its own a goal is flown at the vehicle's cruise.
        speed = goal.speed_mps or self._simulation.vehicle.parameters.cruise_mps
        wait = controller.circle(north, east, -down, speed)
        if isinstance(wait, CircleTrack):
            # From within two radii on, the circle is joined as it is.
            wait = Approach(north, east, 2.0 * wait.radius_m, wait)
        else:
            controller.yaw_rad = goal.yaw_rad
        controller.track = wait
        controller.landing = goal.kind is GoalKind.LAND
