"""The operator flies the simulator's own vehicle, which answers as PX4 does, and an ArduPilot that
refuses the first landing mode."""

import pytest

from analysis.autopilots.ardupilot import ardupilot_process
from analysis.autopilots.flight_operator import Operator
from analysis.autopilots.flight_plan import FlightPlan
from analysis.autopilots.operator_commands import OperatorCommands
from analysis.autopilots.px4 import px4_process
from analysis.run.proxied_flight import ProxiedFlight
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.guidance.waypoints import Waypoint
from simvehicle.scenario.scenario_file import read_scenario

SCENARIO = """
name: on the ground
vehicle: {kind: multirotor, parameters: iris}
sensors:
  imu: {preset: consumer-mems, rate_hz: 100}
  gps: {preset: ideal, rate_hz: 5}
"""
PX4 = px4_process.MODES
PLANE = ardupilot_process.MODES["fixedwing"]
LIMIT_S = 120.0
NORTH = Waypoint(47.3977600, 8.545594, 8.0, 5.0)  # 2 m from the start
WAY_DOWN = (Waypoint(47.0, 8.0, 50.0, 20.0), Waypoint(47.01, 8.0, 0.0, 20.0))


def frame_of(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


POSITION = frame_of("ESTIMATOR_STATUS", flags=16)  # which the simulator's vehicle does not send


@pytest.fixture
def flight(tmp_path):
    file = tmp_path / "scenario.yaml"
    file.write_text(SCENARIO)
    return ProxiedFlight(read_scenario(str(file)), Schedule(0, ()))


def fly(flight, plan):
    """Fly; return the operator and the largest height."""
    parser, highest_m = Parser(), 0.0
    operator = Operator(plan, OperatorCommands(PX4["multirotor"], plan.waypoints, plan.landing))
    operator.receive(POSITION)
    while not operator.finished and flight.t_us < LIMIT_S * 1e6:
        on_ground = flight.simulation.truth.on_ground
        sent = flight.advance(operator.step(flight.t_us, on_ground=on_ground))
        for item in parser.push(b"".join(sent.ground)):
            if isinstance(item, Frame):
                operator.receive(item)
        highest_m = max(highest_m, flight.simulation.truth.height_agl_m)
    return operator, highest_m


def test_it_arms_takes_off_hovers_and_lands(flight):
    operator, highest_m = fly(flight, FlightPlan(8.0, 5.0))
    assert not operator.failure
    assert list(operator.events_us) == ["first-stamp", "arming", "take-off", "landing", "landed"]
    assert highest_m > 5.0
    assert flight.simulation.truth.on_ground


def test_it_uploads_a_mission_and_starts_it(flight):
    operator, _ = fly(flight, FlightPlan(8.0, 20.0, (NORTH,)))
    assert not operator.failure
    assert "mission-item:1" in operator.events_us  # item 0 is the speed


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


def uploaded_items(commands):
    """Upload; return the commands of the items."""
    commands.upload()
    assert sent_commands(commands) == [("MISSION_COUNT", None)]
    for seq in range(8):
        commands.receive(frame_of("MISSION_REQUEST_INT", seq=seq))
    items = [item for _, item in sent_commands(commands)]
    commands.receive(frame_of("MISSION_ACK"))
    return items


def accept(commands, number):
    commands.receive(frame_of("COMMAND_ACK", command=number, result=0))


def test_a_plane_without_autoland_lands_by_the_end_of_its_mission():
    commands = OperatorCommands(PLANE, (), WAY_DOWN)
    # Home, the speed, the approach, the ground; a request behind the last item repeats it.
    assert uploaded_items(commands)[:5] == [21, 178, 16, 21, 21]
    commands.land()
    assert sent_commands(commands) == [(176, 26.0)]
    commands.receive(frame_of("COMMAND_ACK", command=176, result=4))
    commands.land()
    commands.land()  # repeated until it is accepted
    assert sent_commands(commands) == [(224, 0.0)] * 2
    accept(commands, 224)
    commands.land()
    assert sent_commands(commands) == [(176, 10.0)]
    accept(commands, 176)
    commands.land()  # not repeated: that would restart the approach
    assert sent_commands(commands) == []


def test_a_refusal_of_another_mode_does_not_count_for_the_landing_mode():
    commands = OperatorCommands(PLANE, (), WAY_DOWN)
    commands.arm()
    commands.receive(frame_of("COMMAND_ACK", command=176, result=4))
    commands.pending()
    commands.land()
    assert sent_commands(commands) == [(176, 26.0)]


def test_a_px4_plane_leaves_its_automatic_mode_for_a_while_before_it_is_armed():
    commands = OperatorCommands(PX4["fixedwing"], (), WAY_DOWN)
    for _ in range(4):
        commands.arm()
    # Manual for three seconds, then hold.
    assert sent_commands(commands) == [(176, 1.0), (176, 1.0), (176, 1.0), (176, 4.0), (400, 0.0)]


def test_a_px4_plane_circles_between_its_mission_and_the_approach():
    commands = OperatorCommands(PX4["fixedwing"], [NORTH], WAY_DOWN)
    assert uploaded_items(commands)[:6] == [178, 16, 17, 178, 16, 21]
    commands.fly_mission()
    commands.pending()
    commands.land()
    (frame,) = Parser().push(b"".join(commands.pending()))
    assert (frame.number("command"), frame.number("param1")) == (224, 3)  # the approach's speed
