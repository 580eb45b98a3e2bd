"""Commands for an ArduPilot that refuses the first landing mode."""

from analysis.autopilots.ardupilot.ardupilot_commands import PLANE, ArduPilotCommands
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.guidance.waypoints import Waypoint

WAY_DOWN = (Waypoint(47.0, 8.0, 50.0, 20.0), Waypoint(47.01, 8.0, 0.0, 20.0))


def frame_of(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


def sent_commands(commands):
    """Return the names of sent frames, with the second parameter of commands and items."""
    found = []
    for frame in Parser().push(b"".join(commands.pending())):
        assert isinstance(frame, Frame)
        if frame.layout.name == "COMMAND_LONG":
            found.append((int(frame.number("command")), frame.number("param2")))
        else:
            found.append((frame.layout.name, frame.values().get("command")))
    return found


def test_a_plane_without_autoland_lands_by_a_mission():
    commands = ArduPilotCommands(PLANE, WAY_DOWN)
    commands.land()
    assert sent_commands(commands) == [(176, 26.0)]
    commands.receive(frame_of("COMMAND_ACK", command=176, result=4))
    commands.land()
    assert sent_commands(commands) == [("MISSION_COUNT", None)]
    for seq in range(3):
        commands.receive(frame_of("MISSION_REQUEST_INT", seq=seq))
    assert [item for _, item in sent_commands(commands)] == [
        16,
        16,
        21,
    ]  # home, the approach, the ground
    commands.receive(frame_of("MISSION_ACK"))
    commands.land()
    assert sent_commands(commands) == [(176, 10.0), (300, 0.0)]
    commands.land()  # not repeated: a second start would restart the approach
    assert sent_commands(commands) == []


def test_a_refusal_of_another_mode_does_not_count_for_the_landing_mode():
    commands = ArduPilotCommands(PLANE, WAY_DOWN)
    commands.arm()
    commands.receive(frame_of("COMMAND_ACK", command=176, result=4))
    commands.pending()
    commands.land()
    assert sent_commands(commands) == [(176, 26.0)]
