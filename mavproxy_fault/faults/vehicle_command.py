"""Commands to the vehicle as steps of a schedule: arm, take off, inject, land.

A command is sent in reply to the autopilot's HEARTBEAT, which identifies the autopilot, and is
repeated once a second until COMMAND_ACK accepts it; then the entry ends, so that the next step may
follow. No frame is changed.

References
----------
.. [1] MAVLink common message set, MAV_CMD; PX4, `px4_custom_mode.h`.
"""

import math
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import msgspec
from msgspec import Meta

from mavproxy_fault.fault_parts.fault import ActsOn, Generator, Outgoing
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

Parameters = tuple[float, ...]
CommandCall = tuple[int, Parameters]

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
INVALID, ARDUPILOT = 8, 3  # MAV_AUTOPILOT_
FIXED_WING = 1  # MAV_TYPE_
ACCEPTED, IN_PROGRESS = 0, 5  # MAV_RESULT_
RETRY_US = 900_000  # just below the period of heartbeats, 1 s
LOITER, RETURN, LAND, TAKE_OFF = 17, 20, 21, 22  # MAV_CMD_NAV_
SET_MODE, MISSION_START, ARM = 176, 300, 400  # MAV_CMD_
GUIDED, PLANE_TAKE_OFF = 4, 13  # modes of ArduCopter, of ArduPlane
PX4_HOLD = (1.0, 4.0, 3.0)  # custom mode: automatic, loiter
UNKNOWN_HEIGHT_M = math.nan

VehicleAction = Literal["arm", "disarm", "take-off", "hold", "return", "land", "mission"]
SIMPLE_COMMANDS: dict[str, CommandCall] = {
    "arm": (ARM, (1.0,)),
    "disarm": (ARM, (0.0,)),
    "return": (RETURN, ()),
    "land": (LAND, ()),
    "mission": (MISSION_START, ()),
}


class CommandState(NamedTuple):
    """Progress: accepted calls of how many, time and target of the last one, home altitude."""

    granted: int = 0
    calls: int = 1
    at_us: int | None = None
    target: tuple[int, int] = (1, AUTOPILOT)
    field_m: float = UNKNOWN_HEIGHT_M  # above mean sea level


class VehicleCommand(msgspec.Struct, frozen=True, kw_only=True):
    """Command the vehicle (`do`, or a MAV_CMD by `number`); needs `proxy --allow-commands`"""

    name: ClassVar[str] = "command"
    example: ClassVar[dict[str, Any]] = {"do": "take-off", "height_m": 10}
    acts_on: ClassVar[ActsOn] = "frames"
    messages: ClassVar[tuple[str, ...]] = ("HEARTBEAT", "COMMAND_ACK", "GLOBAL_POSITION_INT")
    commands_vehicle: ClassVar[bool] = True

    do: VehicleAction | None = None
    height_m: Annotated[float, Meta(gt=0, lt=1e4)] = 10.0  # of a take-off, above the field
    number: int | None = None
    params: Parameters = ()
    afterwards: Parameters | None = None  # params of `number` sent when the entry ends

    def __post_init__(self) -> None:
        if (self.do is None) == (self.number is None):
            raise ValueError("needs exactly one of do and number")
        if self.number is None and (self.params or self.afterwards is not None):
            raise ValueError("params and afterwards need number; give it instead of do")
        if max(len(self.params), len(self.afterwards or ())) > 7:
            raise ValueError("a command has at most seven params")

    def new_state(self, start_us: int) -> CommandState:
        """Return the state before the first command."""
        return CommandState()

    def apply(
        self, frame: Frame, t_us: int, state: CommandState, rng: Generator
    ) -> tuple[list[Outgoing], CommandState]:
        """Forward the frame; reply to a heartbeat with the command that is not accepted yet."""
        passed = Outgoing(t_us, frame)
        name = frame.layout.name
        if frame.component != AUTOPILOT:
            return [passed], state
        if name == "GLOBAL_POSITION_INT":
            above_m = frame.number("alt") - frame.number("relative_alt")
            return [passed], state._replace(field_m=above_m * 1e-3)
        if name == "COMMAND_ACK":
            return [passed], self._count_acceptance(frame, state)
        autopilot = int(frame.number("autopilot"))
        waited = state.at_us is None or t_us - state.at_us >= RETRY_US
        if autopilot == INVALID or not waited:
            return [passed], state
        calls = self._calls(autopilot, int(frame.number("type")), state.field_m)
        if state.granted >= len(calls):
            return [passed], state
        target = frame.system, frame.component
        request = Outgoing(t_us, command_frame(*calls[state.granted], target), back=True)
        return [passed, request], state._replace(at_us=t_us, target=target, calls=len(calls))

    def done(self, state: CommandState) -> bool:
        """Whether all commands are accepted; an entry with `afterwards` lasts for its `for_s`."""
        return state.granted >= state.calls and self.afterwards is None

    def _count_acceptance(self, frame: Frame, state: CommandState) -> CommandState:
        """Count an acceptance; the next call is then due."""
        if state.at_us is None or frame.number("result") not in (ACCEPTED, IN_PROGRESS):
            return state
        # Only acknowledgements of this command.
        expected = {self.number} if self.number is not None else COMMAND_IDS[self.do or "arm"]
        if int(frame.number("command")) not in expected:
            return state
        return state._replace(granted=state.granted + 1, at_us=None)

    def _calls(self, autopilot: int, kind: int, field_m: float) -> list[CommandCall]:
        """Return the commands in sequence; empty while a value is unknown."""
        if self.number is not None:
            return [(self.number, self.params)]
        ardupilot = autopilot == ARDUPILOT
        if self.do == "hold":
            return [(LOITER, ())] if ardupilot else [(SET_MODE, PX4_HOLD)]
        if self.do != "take-off":
            return [SIMPLE_COMMANDS[self.do or "arm"]]
        if ardupilot and kind == FIXED_WING:
            return [(SET_MODE, (1.0, float(PLANE_TAKE_OFF)))]
        height: Parameters = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan)
        if ardupilot:
            climb = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, self.height_m)
            return [(SET_MODE, (1.0, float(GUIDED))), (TAKE_OFF, climb)]
        # PX4 expects the take-off altitude above mean sea level.
        if math.isnan(field_m):
            return []
        return [(TAKE_OFF, (*height, field_m + self.height_m))]

    def release(self, t_us: int, state: CommandState) -> tuple[list[Outgoing], CommandState]:
        """Send the command with the params `afterwards` at the end, if they are given."""
        if self.number is None or self.afterwards is None or not state.granted:
            return [], state
        restore = command_frame(self.number, self.afterwards, state.target)
        return [Outgoing(t_us, restore, back=True)], state


COMMAND_IDS = {
    **{deed: {call[0]} for deed, call in SIMPLE_COMMANDS.items()},
    "hold": {LOITER, SET_MODE},
    "take-off": {TAKE_OFF, SET_MODE},
}


def command_frame(number: int, parameters: Parameters, target: tuple[int, int]) -> Frame:
    """Return a COMMAND_LONG to a component, sent as the vehicle's onboard computer."""
    system, component = target
    values: dict[str, float] = {
        "command": number,
        "target_system": system,
        "target_component": component,
        **{f"param{place}": value for place, value in enumerate(parameters, 1)},
    }
    layout = message_layout("COMMAND_LONG")
    return Frame(build_frame(layout, values, system=system, component=COMPONENT), layout)
