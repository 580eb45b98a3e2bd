"""The operator's commands for ArduPilot as plain MAVLink; no I/O."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from analysis.autopilots.flight_operator import COMPONENT, GROUND_STATION
from analysis.autopilots.mission_items import (
    ItemFields,
    landing_items,
    waypoint_item,
    waypoint_items,
)
from mavproxy_fault.wire.dialect import Layout, message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from simvehicle.guidance.waypoints import Waypoint

COMMAND_LONG, MISSION_COUNT = message_layout("COMMAND_LONG"), message_layout("MISSION_COUNT")
MISSION_ITEM_INT = message_layout("MISSION_ITEM_INT")
TAKE_OFF, SET_MODE, ARM, START = 22, 176, 400, 300  # MAV_CMD_
CUSTOM_MODE = 1  # MAV_MODE_FLAG_
ACCEPTED, IN_PROGRESS = 0, 5  # MAV_RESULT_
# An upload in progress is driven by the vehicle's requests; ArduPilot gives one up after 8 s.
SILENT_CALLS = 10


@dataclass(frozen=True, slots=True)
class ArduPilotModes:
    """Custom modes of an ArduPilot vehicle; a plane's TAKEOFF mode needs no take-off command."""

    take_off: int
    auto: int
    land: int
    take_off_command: bool


COPTER = ArduPilotModes(take_off=4, auto=3, land=9, take_off_command=True)  # GUIDED, AUTO, LAND
PLANE = ArduPilotModes(
    take_off=13, auto=10, land=26, take_off_command=False
)  # TAKEOFF, AUTO, AUTOLAND


class ArduPilotCommands:
    """Commands for an ArduPilot with system id 1.

    Parameters
    ----------
    modes : Modes
    landing : sequence of Waypoint
        Landing approach of a plane whose version has no landing mode.
    """

    awaiting_reply = False  # its replies come in vehicle time

    def __init__(self, modes: ArduPilotModes, landing: Sequence[Waypoint] = ()) -> None:
        self._modes, self._landing = modes, landing
        self._requested_mode = -1
        self._cannot_land = self._landing_uploaded = False
        self._items: list[ItemFields] = []
        self._calls_until_count = 0  # while an upload is in progress: silent calls to wait
        self._seq = 0
        self._pending: list[bytes] = []

    def pending(self) -> list[bytes]:
        """Return and clear the frames to send."""
        frames, self._pending = self._pending, []
        return frames

    def receive(self, frame: Frame) -> None:
        """Answer requests for mission items, and note refused modes."""
        if frame.layout.name == "COMMAND_ACK" and frame.number("command") == SET_MODE:
            refused = frame.number("result") not in (ACCEPTED, IN_PROGRESS)
            # ArduPlane before 4.7 has no AUTOLAND.
            self._cannot_land |= refused and self._requested_mode == self._modes.land
        elif frame.layout.name == "MISSION_ACK" and self._cannot_land:
            self._landing_uploaded = frame.number("type") == 0
        if frame.layout.name == "MISSION_ACK" and frame.number("type") != 0:
            self._calls_until_count = 0  # refused: begin again
        if frame.layout.name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and self._items:
            self._calls_until_count = SILENT_CALLS
            number = min(int(frame.number("seq")), len(self._items) - 1)
            self._send(MISSION_ITEM_INT, {"seq": number, "autocontinue": 1, **self._items[number]})

    def upload(self, waypoints: Sequence[Waypoint]) -> None:
        """Announce the mission; its first item is ArduPilot's home position."""
        self._announce([waypoint_item(waypoints[0]), *waypoint_items(waypoints)])

    def arm(self) -> None:
        """Arm in the take-off mode."""
        self._mode(self._modes.take_off)
        self._command(ARM, 1.0)

    def take_off(self, height_m: float) -> None:
        """Take off; a plane's take-off mode needs no command."""
        if self._modes.take_off_command:
            self._command(TAKE_OFF, 0, 0, 0, 0, 0, 0, height_m)

    def fly_mission(self) -> None:
        """Start the mission."""
        self._mode(self._modes.auto)
        self._command(START)

    def land(self) -> None:
        """Switch to the landing mode, or fly the landing as a mission."""
        if not (self._cannot_land and self._landing):
            self._mode(self._modes.land)
        elif not self._landing_uploaded:
            self._announce([waypoint_item(self._landing[0]), *landing_items(self._landing)])
        elif self._requested_mode != self._modes.auto:
            self.fly_mission()

    def _announce(self, items: list[ItemFields]) -> None:
        """Send MISSION_COUNT, unless these items are being uploaded: that would begin anew."""
        if items != self._items:
            self._items, self._calls_until_count = items, 0
        if self._calls_until_count > 0:
            self._calls_until_count -= 1
            return
        self._send(MISSION_COUNT, {"count": len(items)})

    def _mode(self, number: int) -> None:
        self._requested_mode = number
        self._command(SET_MODE, CUSTOM_MODE, number)

    def _command(self, number: int, *parameters: float) -> None:
        values: dict[str, object] = {f"param{n}": value for n, value in enumerate(parameters, 1)}
        self._send(COMMAND_LONG, values | {"command": number})

    def _send(self, layout: Layout, values: Mapping[str, object]) -> None:
        self._seq = (self._seq + 1) & 0xFF
        values = {"target_system": 1, "target_component": 1, **values}
        self._pending.append(
            build_frame(layout, values, seq=self._seq, system=GROUND_STATION, component=COMPONENT)
        )
