"""Makes the built-in controller fly the goals of a `CommandedFlight`."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from simvehicle.autopilot.flight_goals import CommandedFlight, Goal, GoalKind
from simvehicle.guidance.route import CircleTrack, GuidanceTrack, Setpoint
from simvehicle.vehicles.body import Controls


@dataclass(frozen=True)
class Approach:
    """A straight course to a position, then the track that waits there.

    Without it a fixed wing would join a distant circle in a wide spiral.
    """

    north_m: float
    east_m: float
    near_m: float
    waiting_track: GuidanceTrack

    def setpoint_from(self, north_m: float, east_m: float, ahead_m: float) -> Setpoint:
        """Steer straight to the position until within `near_m`, then follow the waiting track."""
        # Height and speed are those of the waiting track from the start.
        setpoint = self.waiting_track.setpoint_from(north_m, east_m, ahead_m)
        dn, de = self.north_m - north_m, self.east_m - east_m
        if math.hypot(dn, de) < self.near_m:
            return setpoint
        return Setpoint(math.atan2(de, dn), 0.0, 0.0, setpoint.height_m, setpoint.speed_mps)


class Pilot:
    """Turns the current goal into idle controls or a track for the built-in controller."""

    def __init__(self, simulation: Any, flight: CommandedFlight) -> None:
        self._simulation = simulation
        self.flight = flight
        self._goal: Goal | None = None
        # As many actuators as the vehicle has, all off.
        self._idle = Controls(np.zeros(simulation.vehicle.controls_count), armed=False)

    def controls(self) -> Controls | None:
        """Idle controls on the ground; None while the built-in controller flies."""
        goal = self.flight.goal
        if goal.kind is GoalKind.IDLE:
            self._goal = None
            return self._idle
        # Compare identity: an equal goal that is set again restarts the track.
        if goal is not self._goal:
            self._goal = goal
            self._start_track(goal)
        return None

    def _start_track(self, goal: Goal) -> None:
        controller = self._simulation.controller
        north, east, down = goal.r_ned_m.tolist()
        # A goal without a speed is flown at cruise speed.
        speed = goal.speed_mps or self._simulation.vehicle.parameters.cruise_mps
        track = controller.circle(north, east, -down, speed)
        if isinstance(track, CircleTrack):
            # Within two radii the circle is joined directly.
            track = Approach(north, east, 2.0 * track.radius_m, track)
        else:
            controller.yaw_rad = goal.yaw_rad
        controller.track = track
        controller.landing = goal.kind is GoalKind.LAND
