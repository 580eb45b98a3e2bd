"""The command service: every command gets exactly one COMMAND_ACK.

COMMAND_LONG and COMMAND_INT share their handlers. A command that this vehicle does not implement is
answered UNSUPPORTED at once, so that the ground station does not wait for a timeout.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame as WireFrame
from simvehicle.autopilot import telemetry
from simvehicle.autopilot.enums import BaseMode, Command, CommandResult, CoordinateFrame, FlightMode
from simvehicle.autopilot.flight_goals import CommandedFlight
from simvehicle.autopilot.mission_service import RELATIVE_FRAMES
from simvehicle.autopilot.parameter_service import Parameters
from simvehicle.autopilot.streams import Streams
from simvehicle.autopilot.telemetry import Snapshot, available_modes
from simvehicle.hil.hil_messages import Message, make_message

FORCE_ARMING = 21196  # MAV_CMD_COMPONENT_ARM_DISARM.param2: arm or disarm in any state
FAILURE_MOTOR = 101  # FAILURE_UNIT_SYSTEM_MOTOR
FAILURE_OK, FAILURE_OFF = 0, 1  # FAILURE_TYPE
AVAILABLE_MODES = message_layout("AVAILABLE_MODES").id
POSITION_UNKNOWN = 0x7FFFFFFF  # COMMAND_INT.x, .y: keep the current position


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """A COMMAND_LONG or COMMAND_INT; latitude and longitude in degrees, height in m."""

    command: int
    params: tuple[float, float, float, float]
    lat_deg: float
    lon_deg: float
    z_m: float
    frame: int


# Whether it is accepted (else denied), another result, or the messages of an accepted one
CommandAnswer = bool | CommandResult | list[Message]
CommandHandler = Callable[[CommandRequest, Snapshot], CommandAnswer]


class Commands:
    """Carries out commands on the flight, the streams and the parameters of one vehicle."""

    def __init__(
        self,
        flight: CommandedFlight,
        streams: Streams,
        parameters: Parameters,
        fail_motor: Callable[[int, bool], bool],
    ) -> None:
        self._fail_motor = fail_motor
        self._flight = flight
        self._streams = streams
        self._parameters = parameters
        self._handlers: dict[int, CommandHandler] = {
            Command.ARM_DISARM: self._arm,
            Command.TAKEOFF: self._take_off,
            Command.LAND: lambda request, snapshot: flight.set_mode(FlightMode.LAND),
            Command.RETURN_TO_LAUNCH: lambda request, snapshot: flight.set_mode(FlightMode.RETURN),
            Command.MISSION_START: self._start_mission,
            Command.SET_MODE: self._set_mode,
            Command.REPOSITION: self._reposition,
            Command.PAUSE_CONTINUE: lambda request, snapshot: flight.set_mode(
                FlightMode.MISSION if request.params[0] == 1 else FlightMode.HOLD
            ),
            Command.CHANGE_SPEED: lambda request, snapshot: flight.set_speed(request.params[1]),
            Command.SET_MISSION_CURRENT: lambda request, snapshot: flight.set_current(
                integer_parameter(request.params[0])
            ),
            Command.GET_HOME_POSITION: _answer_with(telemetry.home_position),
            Command.GET_MESSAGE_INTERVAL: self._get_interval,
            Command.SET_MESSAGE_INTERVAL: self._set_interval,
            Command.REQUEST_MESSAGE: self._request_message,
            Command.REQUEST_PROTOCOL_VERSION: _answer_with(telemetry.protocol_version),
            Command.REQUEST_AUTOPILOT_CAPABILITIES: _answer_with(telemetry.autopilot_version),
            Command.INJECT_FAILURE: self._inject,
        }

    def received(self, frame: WireFrame, snapshot: Snapshot) -> list[Message]:
        """Execute a COMMAND_LONG or COMMAND_INT; returns its COMMAND_ACK, then its messages."""
        request = read_command_request(frame)
        handler = self._handlers.get(request.command)
        # Unknown commands are answered too, as a ground station repeats unanswered ones.
        answer = handler(request, snapshot) if handler else CommandResult.UNSUPPORTED
        messages = answer if isinstance(answer, list) else []
        if isinstance(answer, list | bool):
            answer = CommandResult.DENIED if answer is False else CommandResult.ACCEPTED
        ack = make_message(
            "COMMAND_ACK",
            command=request.command,
            result=answer,
            target_system=frame.system,
            target_component=frame.component,
        )
        return [ack, *messages]

    def set_mode(self, frame: WireFrame) -> None:
        """Execute the deprecated SET_MODE message, which has no acknowledgement."""
        if int(frame.number("base_mode")) & BaseMode.CUSTOM:
            self._custom_mode(int(frame.number("custom_mode")))

    def _arm(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        if request.params[0] == 1:
            self._flight.arm()
            return True
        return request.params[0] == 0 and self._flight.disarm(request.params[1] == FORCE_ARMING)

    def _take_off(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        self._flight.take_off(self._amsl(request))
        return True

    def _start_mission(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        first = request.params[0]
        # NaN: without an item number the mission continues at the current item.
        if math.isfinite(first) and not self._flight.set_current(integer_parameter(first)):
            return False
        if not self._flight.set_mode(FlightMode.MISSION):
            return False
        self._flight.arm()
        return True

    def _set_mode(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        base, main, sub, _ = (max(integer_parameter(v), 0) for v in request.params)
        # PX4's modes are custom modes.
        if not base & BaseMode.CUSTOM:
            return CommandResult.UNSUPPORTED
        # PX4's custom_mode: sub-mode in the top byte, main mode in the one below.
        return self._custom_mode(sub << 24 | main << 16)

    def _custom_mode(self, custom_mode: int) -> CommandAnswer:
        known = custom_mode in set(FlightMode)
        return known and self._flight.set_mode(FlightMode(custom_mode))

    def _reposition(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        speed = request.params[0]
        # A command without a speed keeps the current one.
        if math.isfinite(speed) and speed > 0:
            self._flight.set_speed(speed)
        yaw = request.params[3]
        return self._flight.go_to(request.lat_deg, request.lon_deg, self._amsl(request), yaw)

    def _get_interval(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        number = integer_parameter(request.params[0])
        interval = self._streams.interval_us(number)
        # An unknown message is answered too, with interval 0.
        return [make_message("MESSAGE_INTERVAL", message_id=max(number, 0), interval_us=interval)]

    def _set_interval(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        number, interval = request.params[:2]
        if not math.isfinite(interval):
            return False
        known = self._streams.set_interval(integer_parameter(number), interval)
        return known or CommandResult.UNSUPPORTED

    def _request_message(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        number, index = integer_parameter(request.params[0]), integer_parameter(request.params[1])
        # The modes are listed by index and not streamed.
        if number == AVAILABLE_MODES:
            return available_modes(max(index, 0)) or CommandResult.UNSUPPORTED
        return self._streams.make_requested(number, snapshot) or CommandResult.UNSUPPORTED

    def _inject(self, request: CommandRequest, snapshot: Snapshot) -> CommandAnswer:
        """Stop or start motors; a proxy on the link injects all other failures.

        As in PX4, failures are denied while SYS_FAILURE_EN is 0.
        """
        if self._parameters["SYS_FAILURE_EN"] != 1:
            return False
        unit, kind, instance, mask = (integer_parameter(value) for value in request.params[:4])
        if unit != FAILURE_MOTOR or kind not in (FAILURE_OK, FAILURE_OFF):
            return CommandResult.UNSUPPORTED
        # Param 4 is a bitmask of instances, used if param 3 is NaN.
        chosen = (
            [n for n in range(1, 17) if max(mask, 0) >> n - 1 & 1] if instance < 0 else [instance]
        )
        return any([self._fail_motor(number, kind == FAILURE_OFF) for number in chosen])

    def _amsl(self, request: CommandRequest) -> float:
        relative = request.frame in RELATIVE_FRAMES
        return request.z_m + (self._flight.home.alt_m if relative else 0.0)


def _answer_with(make: Callable[[Snapshot], Message]) -> CommandHandler:
    return lambda request, snapshot: [make(snapshot)]


def integer_parameter(value: float) -> int:
    """A command parameter as an integer; NaN and infinity become -1, which no handler accepts."""
    # COMMAND_LONG has float parameters only, where NaN means not set.
    return int(value) if math.isfinite(value) else -1


def read_command_request(frame: WireFrame) -> CommandRequest:
    """The command in a COMMAND_LONG or COMMAND_INT."""
    p1, p2, p3, p4 = (float(frame.number(f"param{i}")) for i in range(1, 5))
    if frame.layout.name == "COMMAND_LONG":
        lat_deg, lon_deg, z_m = (float(frame.number(f"param{i}")) for i in range(5, 8))
        # COMMAND_LONG has no frame field: its heights are above mean sea level.
        kind = int(CoordinateFrame.GLOBAL)
    else:
        # COMMAND_INT has degrees scaled by 1e7, finer than the floats of COMMAND_LONG.
        x, y = int(frame.number("x")), int(frame.number("y"))
        lat_deg = math.nan if x == POSITION_UNKNOWN else x * 1e-7
        lon_deg = math.nan if y == POSITION_UNKNOWN else y * 1e-7
        z_m = float(frame.number("z"))
        kind = int(frame.number("frame"))
    return CommandRequest(
        int(frame.number("command")), (p1, p2, p3, p4), lat_deg, lon_deg, z_m, kind
    )
