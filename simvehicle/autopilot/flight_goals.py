"""PX4's automatic flight modes as goals for the built-in controller.

`CommandedFlight` holds mode, arming and mission progress; `advance` looks at the truth once a step
and sets `goal`, which the vehicle's own controller follows. Aborting, climbing and landing follow
PX4's modes TAKEOFF, HOLD, MISSION, RETURN and LAND in outline [1]_.

References
----------
.. [1] PX4 user guide, "Flight Modes (Multicopter)".
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from simvehicle.autopilot.enums import Command, FlightMode, LandedState
from simvehicle.autopilot.mission_service import MissionItem, Missions
from simvehicle.autopilot.parameter_service import Parameters
from simvehicle.autopilot.telemetry import HomePosition
from simvehicle.hil.hil_messages import Message, make_message, statustext
from simvehicle.vehicles.body import Truth

HEIGHT_TOLERANCE_M = 1.0  # within which a height is reached; about PX4's NAV_MC_ALT_RAD
SLOWEST_COMMAND_MPS = 0.5  # chosen

LocateNed = Callable[[float, float, float], Array]  # latitude, longitude in degrees, m MSL -> NED


class GoalKind(Enum):
    """What the controller does to reach a goal."""

    IDLE = "idle"  # actuators off
    FLY = "fly"  # go to `r_ned_m` and stay there
    LAND = "land"  # go above `r_ned_m`, then descend to the ground


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to fly; `speed_mps` None and `yaw_rad` NaN leave the choice to the vehicle."""

    kind: GoalKind
    r_ned_m: Array
    speed_mps: float | None = None
    yaw_rad: float = math.nan


class CommandedFlight:
    """Mode, arming and mission progress of one vehicle under a ground station.

    Parameters
    ----------
    locate : callable
        Turns latitude, longitude (degrees) and height (m above sea level) into local NED (3,).
    airborne : bool
        The vehicle starts in the air: armed, in HOLD.
    own_mission : bool
        The built-in controller flies the scenario's mission until the first command: armed, in
        MISSION.
    acceptance_m : float
        Horizontal distance within which a position counts as reached.
    """

    def __init__(
        self,
        parameters: Parameters,
        missions: Missions,
        home: HomePosition,
        locate: LocateNed,
        *,
        airborne: bool = False,
        own_mission: bool = False,
        acceptance_m: float = 2.0,
    ) -> None:
        self.home = home
        self.mode = FlightMode.MISSION if own_mission else FlightMode.HOLD
        self.armed = airborne or own_mission
        self.commanded = False  # whether a ground station has taken over
        self.landed = LandedState.IN_AIR if airborne else LandedState.ON_GROUND
        self.goal = Goal(GoalKind.IDLE, np.zeros(3))  # until the first `advance`
        self.seq = 0
        self._own_mission = own_mission
        self._parameters = parameters
        self._missions = missions
        # A mission is identified by its revision, as two missions may have equal items.
        self._mission_seen = missions.revision
        self._locate = locate
        self._acceptance_m = acceptance_m
        self._speed_mps: float | None = None
        self._truth: Truth | None = None
        self._goal_item: MissionItem | None = None  # the item that the goal was made from
        self._reached_us: int | None = None  # since when the current item is reached
        self._ground_us: int | None = None  # since when a landing vehicle is on the ground

    @property
    def goal_active(self) -> bool:
        """Whether the controller follows `goal`; False while it flies the scenario's mission."""
        return self.commanded or not self._own_mission

    # -- what a ground station commands ------------------------------------------------------------

    def arm(self) -> None:
        """Arm the motors and apply the mode; no effect if already armed."""
        if self.armed:
            return
        # LAND would land again at once, and MISSION needs items: fall back to HOLD.
        unflyable = self.mode == FlightMode.MISSION and not self._missions.items
        if unflyable or self.mode in (FlightMode.LAND, FlightMode.RETURN):
            self.mode = FlightMode.HOLD
        self.armed = self.commanded = True
        self._enter_mode(self.mode)

    def disarm(self, force: bool) -> bool:
        """Disarm the motors; returns False in the air unless forced, as PX4 does."""
        if self.armed and self.landed != LandedState.ON_GROUND and not force:
            return False
        self.armed = False
        self.commanded = True
        self.goal = replace(self.goal, kind=GoalKind.IDLE)
        return True

    def set_mode(self, mode: FlightMode) -> bool:
        """Change the mode; returns False for MISSION without mission items."""
        if mode == FlightMode.MISSION:
            if not self._missions.items:
                return False
            # The built-in controller is already flying the scenario's mission.
            if self.armed and not self.goal_active and not self._missions.revision:
                return True
        if self.armed and self.goal_active and mode == self.mode:
            return True  # a repeated command must not restart a landing's time on the ground
        self.commanded = True
        self._enter_mode(mode)
        return True

    def take_off(self, alt_m: float) -> None:
        """Climb at the current position to `alt_m` above sea level (NaN: MIS_TAKEOFF_ALT).

        MIS_TAKEOFF_ALT is also the lowest, as in PX4: MAVProxy's `takeoff 10` is above home.
        """
        self.commanded = True
        self._enter_mode(FlightMode.TAKEOFF)
        if alt_m > self.home.alt_m + float(self._parameters["MIS_TAKEOFF_ALT"]):
            self.goal = replace(self.goal, r_ned_m=self._position_at(alt_m))

    def go_to(self, lat_deg: float, lon_deg: float, alt_m: float, yaw_rad: float) -> bool:
        """Fly to a position and hold; NaN keeps a value. Returns False on the ground."""
        if not self.armed or self.landed == LandedState.ON_GROUND:
            return False
        self.commanded = True
        self.mode = FlightMode.HOLD
        current = self._position()
        # NED counts down: height above home is -down.
        alt_m = alt_m if math.isfinite(alt_m) else self.home.alt_m - float(current[2])
        if math.isfinite(lat_deg) and math.isfinite(lon_deg):
            position = self._locate(lat_deg, lon_deg, alt_m)
        else:
            position = self._position_at(alt_m)
        self.goal = Goal(GoalKind.FLY, position, self._speed_mps, yaw_rad)
        return True

    def set_speed(self, speed_mps: float) -> bool:
        """Set the speed over ground; a negative value restores the vehicle's cruise speed.

        Returns False for a speed too low to fly.
        """
        if not math.isfinite(speed_mps) or 0 <= speed_mps < SLOWEST_COMMAND_MPS:
            return False
        self._speed_mps = speed_mps if speed_mps > 0 else None
        self.goal = replace(self.goal, speed_mps=self._speed_mps)
        return True

    def set_current(self, seq: int) -> bool:
        """Continue with another mission item; returns False if there is no such item."""
        if not 0 <= seq < len(self._missions.items):
            return False
        # The scenario's mission is flown as a path without items: from here on items are flown.
        if self.armed and not self.goal_active and seq != self.seq:
            self.commanded = True
            self._enter_mode(FlightMode.MISSION)
        self.seq = seq
        self._reached_us = None
        return True

    # -- what happens without a command ------------------------------------------------------------

    def advance(self, truth: Truth) -> list[Message]:
        """Update the goal and the mission progress from the truth; returns what to report."""
        # The goal of the first mode needs the first position.
        first = self._truth is None
        self._truth = truth
        if first:
            self._enter_mode(self.mode)
        # A new mission was uploaded: start at its first item.
        if self._missions.revision != self._mission_seen:
            self._mission_seen = self._missions.revision
            self.seq = 0
            self._reached_us = None
            if self.goal_active and self.mode == FlightMode.MISSION and not self._missions.items:
                self._enter_mode(FlightMode.HOLD)
        messages: list[Message] = []
        if self.armed and self.goal_active:
            messages = self._fly(truth)
        self.landed = self._landed_state(truth)
        return messages

    def _fly(self, truth: Truth) -> list[Message]:
        if self.mode == FlightMode.TAKEOFF:
            # Height alone: wind may displace the vehicle horizontally.
            if abs(self.goal.r_ned_m[2] - truth.r_ned_m[2]) < HEIGHT_TOLERANCE_M:
                self.mode = FlightMode.HOLD
                return [statustext("Takeoff complete")]
        elif self.mode == FlightMode.MISSION:
            return self._fly_mission(truth)
        elif self.mode == FlightMode.RETURN:
            if self._has_reached(self.goal.r_ned_m):
                self._enter_mode(FlightMode.LAND)
        elif self.mode == FlightMode.LAND:
            return self._touch_down(truth)
        return []

    def _fly_mission(self, truth: Truth) -> list[Message]:
        item = self._missions.items[self.seq]
        if item.command == Command.RETURN_TO_LAUNCH:
            self._enter_mode(FlightMode.RETURN)
            # The item counts as reached when its command starts.
            return [make_message("MISSION_ITEM_REACHED", seq=self.seq)]
        if item.command == Command.CHANGE_SPEED:
            self.set_speed(item.params[1])
        elif item.command != Command.DELAY:
            # Compare identity: two equal items in a row are two goals.
            if self._goal_item is not item:
                self._goal_item = item
                kind = GoalKind.LAND if item.command == Command.LAND else GoalKind.FLY
                yaw = math.radians(item.params[3])
                self.goal = Goal(kind, self._item_position(item), self._speed_mps, yaw)
            if self.goal.kind is GoalKind.LAND:
                return self._touch_down(truth)
            # An item stays reached even if wind carries the vehicle away again.
            if self._reached_us is None and not self._has_reached(self.goal.r_ned_m):
                return []
        # Items without a position, such as a delay, are reached at once.
        if self._reached_us is None:
            self._reached_us = truth.t_us
        return self._finish_item(item, truth.t_us)

    def _finish_item(self, item: MissionItem, t_us: int) -> list[Message]:
        """Wait for the item's hold time, then continue with the next item."""
        # Unlimited: until the next command.
        if item.command == Command.LOITER_UNLIMITED:
            return []
        waits = item.command in (Command.WAYPOINT, Command.LOITER_TIME, Command.DELAY)
        wait_s = item.params[0] if waits and math.isfinite(item.params[0]) else 0.0
        # The hold time starts at the position, not on the way there.
        if self._reached_us is None or t_us - self._reached_us < wait_s * 1e6:
            return []
        reached = make_message("MISSION_ITEM_REACHED", seq=self.seq)
        self._reached_us = None
        if self.seq + 1 < len(self._missions.items):
            self.seq += 1
            return [reached]
        self.mode = FlightMode.HOLD
        return [reached, statustext("Mission finished, loitering")]

    def _touch_down(self, truth: Truth) -> list[Message]:
        """Disarm after COM_DISARM_LAND seconds on the ground."""
        # A bounce restarts the time.
        if not truth.on_ground:
            self._ground_us = None
            return []
        if self._ground_us is None:
            self._ground_us = truth.t_us
        if truth.t_us - self._ground_us < self._parameters["COM_DISARM_LAND"] * 1e6:
            return []
        self.armed = False
        self.goal = replace(self.goal, kind=GoalKind.IDLE)
        messages = [statustext("Landing detected"), statustext("Disarmed by landing")]
        if self.mode == FlightMode.MISSION:
            messages.insert(0, make_message("MISSION_ITEM_REACHED", seq=self.seq))
        return messages

    def _enter_mode(self, mode: FlightMode) -> None:
        """Set a mode, and its goal from the current position."""
        self.mode = mode
        self._goal_item = None
        self._reached_us = self._ground_us = None
        if not self.armed:
            return
        if mode == FlightMode.TAKEOFF:
            height = self._parameters["MIS_TAKEOFF_ALT"]
            position = self._position_at(self.home.alt_m + height)
        elif mode == FlightMode.RETURN:
            current = self._position()
            # Never below the current height: there may be obstacles on the way home.
            height = max(float(self._parameters["RTL_RETURN_ALT"]), -float(current[2]))
            position = self._locate(self.home.lat_deg, self.home.lon_deg, self.home.alt_m + height)
        else:
            position = self._position()
        kind = GoalKind.LAND if mode == FlightMode.LAND else GoalKind.FLY
        # In HOLD on the ground the motors stay off.
        if mode == FlightMode.HOLD and self.landed == LandedState.ON_GROUND:
            kind = GoalKind.IDLE
        self.goal = Goal(kind, position, self._speed_mps)

    def _landed_state(self, truth: Truth) -> LandedState:
        if truth.on_ground:
            return LandedState.ON_GROUND
        if self.mode == FlightMode.TAKEOFF:
            return LandedState.TAKEOFF
        # The LAND item of a mission counts as landing, too.
        landing = self.mode == FlightMode.LAND or self.goal.kind is GoalKind.LAND
        return LandedState.LANDING if landing else LandedState.IN_AIR

    def _item_position(self, item: MissionItem) -> Array:
        """Position of an item in NED; 0, 0 means here, as in a take-off item without a position."""
        alt_m = item.z_m + (self.home.alt_m if item.relative else 0.0)
        if item.x_degE7 == 0 and item.y_degE7 == 0:
            return self._position_at(alt_m)
        return self._locate(item.x_degE7 * 1e-7, item.y_degE7 * 1e-7, alt_m)

    def _position(self) -> Array:
        return np.zeros(3) if self._truth is None else self._truth.r_ned_m.copy()

    def _position_at(self, alt_m: float) -> Array:
        current = self._position()
        current[2] = self.home.alt_m - alt_m
        return current

    def _has_reached(self, position: Array) -> bool:
        north, east, down = (position - self._position()).tolist()
        near = math.hypot(north, east) < self._acceptance_m
        # A circling vehicle has a large acceptance radius, which applies to its height, too.
        return near and abs(down) < max(HEIGHT_TOLERANCE_M, self._acceptance_m)
