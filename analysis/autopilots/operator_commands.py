"""The operator's commands as plain MAVLink, for PX4 and ArduPilot alike; no I/O."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mavproxy_fault.wire.dialect import Layout, message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from simvehicle.autopilot.enums import Command
from simvehicle.autopilot.mission_service import MissionItem, waypoint_items
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
    landing : sequence of Waypoint
        Landing approach of a plane whose version has no landing mode.
    """

    def __init__(self, modes: OperatorModes, landing: Sequence[Waypoint] = ()) -> None:
        self._modes = modes
        self._landing = self._landing_items(landing) if landing else ()
        self._before_arming = list(modes.before_arming)
        self._requested_mode: Mode = ()
        self._cannot_land, self._landing_uploaded = not modes.land, False
        self._items: tuple[MissionItem, ...] = ()  # announced, and started
        self._started: tuple[MissionItem, ...] = ()
        self._calls_until_count = 0  # while an upload is in progress: silent calls to wait
        self._seq = 0
        self._pending: list[bytes] = []

    def pending(self) -> list[bytes]:
        """Return and clear the frames to send."""
        frames, self._pending = self._pending, []
        return frames

    def receive(self, frame: Frame) -> None:
        """Answer requests for mission items, and note refused modes."""
        name = frame.layout.name
        if name == "COMMAND_ACK" and frame.number("command") == Command.SET_MODE:
            refused = frame.number("result") not in (ACCEPTED, IN_PROGRESS)
            # ArduPlane before 4.7 has no AUTOLAND.
            self._cannot_land |= refused and self._requested_mode == self._modes.land
        elif name == "MISSION_ACK":
            accepted = frame.number("type") == 0
            self._landing_uploaded = accepted and self._items is self._landing
            if not accepted:
                self._calls_until_count = 0  # refused: begin again
        elif name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and self._items:
            self._calls_until_count = SILENT_CALLS
            number = min(int(frame.number("seq")), len(self._items) - 1)
            self._send(MISSION_ITEM_INT, {"seq": number, **self._items[number].values()})

    def upload(self, waypoints: Sequence[Waypoint]) -> None:
        """Announce the mission."""
        if not self._items:
            self._items = self._with_home(waypoint_items(waypoints))
        self._announce(self._items)

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
        self._started = self._items

    def land(self) -> None:
        """Switch to the landing mode, or fly the landing as a mission."""
        if not (self._cannot_land and self._landing):
            self._set_mode(self._modes.land)
        elif not self._landing_uploaded:
            self._announce(self._landing)
        elif self._started is not self._landing:
            self.fly_mission()

    def _landing_items(self, approach: Sequence[Waypoint]) -> tuple[MissionItem, ...]:
        """The items of an approach, the last of which is LAND."""
        *items, last = waypoint_items(approach)
        return self._with_home((*items, replace(last, command=Command.LAND)))

    def _with_home(self, items: tuple[MissionItem, ...]) -> tuple[MissionItem, ...]:
        # Any position will do: ArduPilot replaces it.
        return (items[-1], *items) if self._modes.home_is_first else items

    def _announce(self, items: tuple[MissionItem, ...]) -> None:
        """Send MISSION_COUNT, unless these items are being uploaded: that would begin anew."""
        if items is not self._items:
            self._items, self._calls_until_count = items, 0
        if self._calls_until_count > 0:
            self._calls_until_count -= 1
            return
        self._send(MISSION_COUNT, {"count": len(items)})

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
