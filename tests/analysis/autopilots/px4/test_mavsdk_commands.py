"""MAVSDK flies the simulator's own vehicle, without a socket, through the operator of a run."""

import time
from contextlib import closing

import pytest

from analysis.autopilots.flight_operator import Operator
from analysis.autopilots.flight_plan import FlightPlan
from analysis.autopilots.px4.mavsdk_commands import MavsdkCommands
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
ESTIMATOR_STATUS = message_layout("ESTIMATOR_STATUS")  # which the simulator's vehicle does not send
POSITION = Frame(build_frame(ESTIMATOR_STATUS, {"flags": 16}), ESTIMATOR_STATUS)
LIMIT_S = 60.0
SPEED = 20.0  # times real time; MAVSDK needs wall time
NORTH = Waypoint(47.3977600, 8.545594, 8.0, 5.0)  # 2 m from the start


@pytest.fixture
def flight(tmp_path):
    file = tmp_path / "scenario.yaml"
    file.write_text(SCENARIO)
    return ProxiedFlight(read_scenario(str(file)), Schedule(0, ()))


def fly(flight, plan):
    """Fly; return the operator and the largest height."""
    parser, highest_m = Parser(), 0.0
    begin_s = time.monotonic()
    with closing(MavsdkCommands(plan.landing)) as commands:
        operator = Operator(plan, commands)
        operator.receive(POSITION)
        while not operator.finished and (wall_s := time.monotonic() - begin_s) < LIMIT_S:
            if flight.t_us * 1e-6 > SPEED * wall_s:
                continue
            sent = flight.advance(operator.step(flight.t_us))
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


def test_a_plane_leaves_its_automatic_mode_for_a_while_before_it_is_armed():
    with closing(MavsdkCommands((NORTH, NORTH))) as commands:
        for _ in range(6):
            commands.arm()
        sent = Parser().push(b"".join(commands.pending()))
    modes = [
        (frame.number("param2"), frame.number("param3"))
        for frame in sent
        if frame.layout.name == "COMMAND_LONG"
    ]
    assert modes == [(1, 0), (1, 0), (1, 0), (4, 3)]  # manual for three seconds, then hold


def test_a_reply_is_awaited_from_the_first_command_on(flight):
    parser = Parser()
    with closing(MavsdkCommands([])) as commands:
        assert not commands.awaiting_reply
        commands.arm()  # no vehicle was found yet
        assert commands.awaiting_reply
        deadline_s = time.monotonic() + LIMIT_S
        while commands.awaiting_reply and time.monotonic() < deadline_s:
            for item in parser.push(b"".join(flight.advance(commands.pending()).ground)):
                if isinstance(item, Frame):
                    commands.receive(item)
            commands.arm()  # as the operator does until the vehicle is armed
        assert not commands.awaiting_reply


def test_it_uploads_a_mission_and_starts_it(flight):
    operator, _ = fly(flight, FlightPlan(8.0, 20.0, (NORTH,)))
    assert not operator.failure
    assert "mission-item:1" in operator.events_us  # item 0 is the speed


def test_recorded_streams_are_not_passed_to_mavsdk(monkeypatch):
    attitude, heartbeat = message_layout("ATTITUDE"), message_layout("HEARTBEAT")
    with closing(MavsdkCommands([])) as commands:
        heard = []
        monkeypatch.setattr(commands._mavsdk, "pass_received_raw_bytes", heard.append)
        for layout in (attitude, heartbeat):
            commands.receive(Frame(build_frame(layout, {}), layout))
    assert heard == [build_frame(heartbeat, {})]
