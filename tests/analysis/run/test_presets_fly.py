"""Presets that act in the simulated receiver fly to the end."""

import msgspec
import pytest

from analysis.run.proxied_flight import ProxiedFlight
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.parser import Parser
from simvehicle.scenario.scenario_file import read_scenario


@pytest.mark.parametrize("name", ["gps-jamming", "gps-receiver-off", "gnss-meaconing"])
def test_a_receiver_without_a_solution_does_not_end_the_flight(name: str) -> None:
    scenario = read_scenario(None)
    imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=50.0)
    sensors = msgspec.structs.replace(scenario.sensors, imu=imu)
    scenario = msgspec.structs.replace(scenario, sensors=sensors, duration_s=3.0)
    entry = {"preset": name, "id": "it", "at_s": 1.0}
    flight = ProxiedFlight(scenario, parse_schedule({"seed": 1, "faults": [entry]}))
    parser, fixes, ground = Parser(), [], []
    while not flight.finished:
        sent = flight.advance([])
        ground += sent.ground
        frames = parser.push(sent.monitor, datagram=False)
        fixes += [f for f in frames if getattr(f, "layout", None) and f.layout.name == "HIL_GPS"]
    assert ground  # telemetry with GPS_RAW_INT continued
    if name == "gps-receiver-off":
        assert len(fixes) < 8  # five per second for one second
