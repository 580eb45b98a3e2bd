"""What an ArduPilot is asked that cannot do what was asked first."""

from analysis.autopilots.ardupilot.ardupilot_commands import PLANE, ArduPilotCommands
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.guidance.waypoints import Waypoint

WAY_DOWN = (Waypoint(47.0, 8.0, 50.0, 20.0), Waypoint(47.01, 8.0, 0.0, 20.0))


def said(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


def asked(requests):
    """Names of what is sent, commands with their second parameter, items with theirs."""
    found = []
    for frame in Parser().push(b"".join(requests.pending())):
        assert isinstance(frame, Frame)
        if frame.layout.name == "COMMAND_LONG":
            found.append((int(frame.number("command")), frame.number("param2")))
        else:
            found.append((frame.layout.name, frame.values().get("command")))
    return found


def test_a_plane_without_autoland_lands_by_a_mission():
    requests = ArduPilotCommands(PLANE, WAY_DOWN)
    requests.land()
    assert asked(requests) == [(176, 26.0)]
    requests.receive(said("COMMAND_ACK", command=176, result=4))
    requests.land()
    assert asked(requests) == [("MISSION_COUNT", None)]
    for seq in range(3):
        requests.receive(said("MISSION_REQUEST_INT", seq=seq))
    assert [item for _, item in asked(requests)] == [16, 16, 21]  # home, the approach, the ground
    requests.receive(said("MISSION_ACK"))
    requests.land()
    assert asked(requests) == [(176, 10.0), (300, 0.0)]
    requests.land()  # once is enough: a second start would begin the approach anew
    assert asked(requests) == []


def test_a_refusal_of_another_mode_does_not_count_for_the_landing_mode():
    requests = ArduPilotCommands(PLANE, WAY_DOWN)
    requests.arm()
    requests.receive(said("COMMAND_ACK", command=176, result=4))
    requests.pending()
    requests.land()
    assert asked(requests) == [(176, 26.0)]
