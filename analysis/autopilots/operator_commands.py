"""The operator's commands as plain MAVLink, for PX4 and ArduPilot alike; no I/O."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mavproxy_fault.wire.dialect import Layout, message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from simvehicle.autopilot.enums import Command
from simvehicle.autopilot.mission_service import waypoint_items
from simvehicle.guidance.waypoints import Waypoint

COMMAND_LONG, MISSION_COUNT = message_layout("COMMAND_LONG"), message_layout("MISSION_COUNT")
MISSION_ITEM_INT = message_layout("MISSION_ITEM_INT")
GROUND_STATION, COMPONENT = 255, 190  # MAV_COMP_ID_MISSIONPLANNER
CUSTOM_MODE = 1.0  # MAV_MODE_FLAG_
ACCEPTED, IN_PROGRESS = 0, 5  # MAV_RESULT_
# An upload in progress is driven by the vehicle's requests; ArduPilot gives one up after 8 s.
SILENT_CALLS = 10

Mode = tuple[float, ...]  # parameters 2 and 3 of MAV_CMD_DO_SET_MODE; no mode if empty


@dataclass(frozen=True, slots=True)
class OperatorModes:
    """An autopilot's modes for a flight, and how it differs from others.

    The modes `before_arming` follow one another; the last one is set when arming. A vehicle either
    `climbs_by_command` or in its mode `take_off`. Without a mode `land` it lands by a mission.
    `home_is_first`: item 0 of a mission is the home position.
    """

    before_arming: tuple[Mode, ...]
    take_off: Mode
    mission: Mode
    land: Mode
    climbs_by_command: bool = False
    home_is_first: bool = False


class OperatorCommands:
    """Commands for an autopilot with system id 1; the operator repeats each until it took effect.

    Parameters
    ----------
    modes : OperatorModes
    waypoints : sequence of Waypoint
    landing : sequence of Waypoint
        Landing approach of a plane whose version has no landing mode. It is the end of the mission:
        an upload in the air would have to compete with the flight.
    """

    def __init__(
        self,
        modes: OperatorModes,
        waypoints: Sequence[Waypoint] = (),
        landing: Sequence[Waypoint] = (),
    ) -> None:
        self._modes = modes
        mission, approach = list(waypoint_items(waypoints)), list(waypoint_items(landing))
        self._landing_commands: list[tuple[float, ...]] = []  # those that are not accepted yet
        if approach:
            if mission:  # in between the plane circles
                mission.append(replace(mission[-1], command=Command.LOITER_UNLIMITED))
            approach[-1] = replace(approach[-1], command=Command.LAND)
            self._landing_commands = [
                (Command.SET_MISSION_CURRENT, len(mission) + modes.home_is_first),
                (Command.SET_MODE, CUSTOM_MODE, *modes.mission),
            ]
        self._items = [*mission, *approach]
        if self._items and modes.home_is_first:
            # Any position will do: ArduPilot replaces it.
            self._items.insert(0, self._items[-1])
        self._before_arming = list(modes.before_arming)
        self._requested_mode: Mode = ()
        self._lands_by_mission = not modes.land
        self._calls_until_count = 0  # while an upload is in progress: silent calls to wait
        self._seq = 0
        self._pending: list[bytes] = []

    @property
    def has_mission(self) -> bool:
        """Whether there are items to upload before the take-off."""
        return bool(self._items)

    def pending(self) -> list[bytes]:
        """Return and clear the frames to send."""
        frames, self._pending = self._pending, []
        return frames

    def receive(self, frame: Frame) -> None:
        """Answer requests for mission items, and note refused modes."""
        name = frame.layout.name
        if name == "COMMAND_ACK":
            self._receive_ack(int(frame.number("command")), int(frame.number("result")))
        elif name == "MISSION_ACK":
            if frame.number("type") != 0:
                self._calls_until_count = 0  # refused: begin again
        elif name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and self._items:
            self._calls_until_count = SILENT_CALLS
            number = min(int(frame.number("seq")), len(self._items) - 1)
            self._send(MISSION_ITEM_INT, {"seq": number, **self._items[number].values()})

    def _receive_ack(self, command: int, result: int) -> None:
        refused = result not in (ACCEPTED, IN_PROGRESS)
        if self._lands_by_mission:
            if not refused and self._landing_commands and command == self._landing_commands[0][0]:
                self._landing_commands.pop(0)
        elif command == Command.SET_MODE and self._requested_mode == self._modes.land:
            # ArduPlane before 4.7 has no AUTOLAND.
            self._lands_by_mission = refused and bool(self._landing_commands)

    def upload(self) -> None:
        """Announce the mission, unless its upload is in progress: that would begin anew."""
        if self._calls_until_count > 0:
            self._calls_until_count -= 1
            return
        self._send(MISSION_COUNT, {"count": len(self._items)})

    def arm(self) -> None:
        """Arm, in the last of the modes before arming."""
        self._set_mode(self._before_arming[0])
        if len(self._before_arming) > 1:
            self._before_arming.pop(0)
        else:
            self._command(Command.ARM_DISARM, 1.0)

    def take_off(self, height_m: float) -> None:
        """Climb; a mode has its height from a parameter of the autopilot."""
        if self._modes.climbs_by_command:
            self._command(Command.TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
        else:
            self._set_mode(self._modes.take_off)

    def fly_mission(self) -> None:
        """Start the uploaded mission; called once, since a repetition would restart it."""
        self._set_mode(self._modes.mission)
        self._command(Command.MISSION_START)

    def land(self) -> None:
        """Switch to the landing mode, or fly the approach at the end of the mission."""
        if not self._lands_by_mission:
            self._set_mode(self._modes.land)
        elif self._landing_commands:
            number, *parameters = self._landing_commands[0]
            self._command(int(number), *parameters)

    def _set_mode(self, mode: Mode) -> None:
        self._requested_mode = mode
        self._command(Command.SET_MODE, CUSTOM_MODE, *mode)

    def _command(self, number: int, *parameters: float) -> None:
        values: dict[str, object] = {f"param{n}": value for n, value in enumerate(parameters, 1)}
        self._send(COMMAND_LONG, values | {"command": number})

    def _send(self, layout: Layout, values: Mapping[str, object]) -> None:
        self._seq = (self._seq + 1) & 0xFF
        values = {"target_system": 1, "target_component": 1, **values}
        self._pending.append(
            build_frame(layout, values, seq=self._seq, system=GROUND_STATION, component=COMPONENT)
        )
