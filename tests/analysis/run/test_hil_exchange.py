"""What faults do between the simulator and an autopilot, on the vehicle's time."""

import pytest

from analysis.run.hil_exchange import ToAutopilot
from analysis.run.proxied_flight import Flight
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.hil.hil_frames import START_US, Hil
from simvehicle.scenario.scenario_file import read_scenario

SCENARIO = """
name: on the ground
vehicle: {kind: multirotor, parameters: iris}
sensors:
  imu: {preset: consumer-mems, rate_hz: 250}
  gps: {preset: consumer, rate_hz: 5}
"""


@pytest.fixture
def flight_of(tmp_path):
    file = tmp_path / "scenario.yaml"
    file.write_text(SCENARIO)
    scenario = read_scenario(str(file))

    def make(**fault) -> Flight:
        return Flight(scenario, parse_schedule({"faults": [{"id": "f", "at_s": 0, **fault}]}))

    return make


def fly(flight, steps):
    """The frames for the autopilot, each with the simulated time of the step they left at."""
    exchange = ToAutopilot(flight, Hil(), hear=lambda send: None)
    parser, found = Parser(), []
    for _ in range(steps):
        t_us, truth, readings = flight.simulation.step(None)
        for raw in exchange.frames(t_us, truth, readings):
            found += [(t_us, item) for item in parser.push(raw) if isinstance(item, Frame)]
    return found


def test_a_delay_is_one_of_the_vehicles_time(flight_of):
    flight = flight_of(fault="delay", target="HIL_GPS", value=0.5, for_s=10)
    late_us = [
        t_us + START_US - frame.number("time_usec")
        for t_us, frame in fly(flight, 400)
        if frame.layout.name == "HIL_GPS" and frame.number("time_usec") > START_US + 200_000
    ]
    assert len(late_us) >= 3
    assert late_us == pytest.approx([500_000] * len(late_us), abs=4_000)  # of a step


def test_steps_go_on_while_their_sensor_frames_are_held_back(flight_of):
    flight = flight_of(fault="delay", target="HIL_SENSOR", value=0.1, for_s=10)
    frames = fly(flight, 100)
    truths = [t_us for t_us, frame in frames if frame.layout.name == "HIL_STATE_QUATERNION"]
    assert len(truths) == 100
    sensors = [
        t_us + START_US - frame.number("time_usec")
        for t_us, frame in frames
        if frame.layout.name == "HIL_SENSOR"
    ]
    assert sensors[-1] == pytest.approx(100_000, abs=4_000)


def test_a_plant_fault_reaches_the_simulated_vehicle(flight_of):
    flight = flight_of(fault="plant", target="PLANT.motor_efficiency[0]", value=0.25, for_s=10)
    asked = []
    flight.simulation.plant = lambda name, value: asked.append((name, value))
    fly(flight, 50)
    assert asked[0] == ("motor_efficiency[0]", 0.25)
