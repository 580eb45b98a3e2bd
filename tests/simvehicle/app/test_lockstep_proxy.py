"""Simulator, proxy and a stand-in for PX4 in lockstep, over real TCP: a fault on the way.

As with a real PX4, the autopilot connects to the proxy, and the proxy to the simulator.
"""

import io
import math
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.server import Server
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.app.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import motor_mix

SCENARIO = """
vehicle: {kind: multirotor, parameters: iris}
environment: {wind_ned_mps: [1.0, 0.0, 0.0], gusts: light}
sensors: {imu: {preset: consumer-mems, rate_hz: 250}, gps: {preset: consumer, rate_hz: 5}}
"""
BIAS_RPS = 0.25
SCHEDULE = """
faults:
  - {id: gyro, fault: bias, target: HIL_SENSOR.zgyro, value: 0.25, at_s: 3.0, for_s: 1.0}
"""
FIRST_US, ARM_US, UNTIL_US = 1_004_000, 1_500_000, 5_000_000
SIMULATOR = 51


def flown(folder: Path, autopilot: Any, schedule: str) -> list[Frame]:
    """Records the simulator's frames as they arrive at the autopilot through the proxy."""
    path = folder / "quad.yaml"
    path.write_text(SCENARIO)
    link = open_link("tcpin:127.0.0.1:0")
    assert isinstance(link, TcpServer)
    progress = Progress(0.0, io.StringIO())
    simulation = Simulation(read_scenario(path))
    loop = LockstepLoop(
        simulation, HilPacker(simulation.board), Inbox(link), motor_mix(4), math.inf, progress
    )
    loop.lockstep = Lockstep(timeout_s=60.0, silence_s=60.0)  # no timeout on a busy machine
    sim = threading.Thread(target=lambda: serve_autopilot(loop, progress, None))
    sim.start()
    master = open_link("tcpin:127.0.0.1:0")
    assert isinstance(master, TcpServer)
    links = [master, open_link(f"tcp:127.0.0.1:{link.port}")]
    proxy = Server(links, Core(link_roles(links), Engine(parse_schedule(schedule))))
    forwarding = threading.Thread(target=proxy.run)
    forwarding.start()
    try:
        autopilot.fly(master.port, UNTIL_US)
    finally:
        proxy.stop()
        forwarding.join(10)
        for each in links:
            each.close()
        sim.join(20)
        link.close()
    items = Parser().push(autopilot.heard)
    frames = [f for f in items if isinstance(f, Frame) and f.component == SIMULATOR]
    truths = [i for i, f in enumerate(frames) if f.layout.name == "HIL_STATE_QUATERNION"]
    # How much of the next step has arrived at the end is random.
    last = next(i for i in truths if frames[i].number("time_usec") >= UNTIL_US)
    return frames[: last + 1]


def zgyro(frames: list[Frame]) -> np.ndarray:
    """Stamp [us] and rate [rad/s] of each sample."""
    sensors = [f for f in frames if f.layout.name == "HIL_SENSOR"]
    return np.array([(f.number("time_usec"), f.number("zgyro")) for f in sensors])


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory, hover: Any) -> tuple[Any, Any]:
    """The same flight without and with the fault: the frames and the autopilot's record."""
    folder, flights = tmp_path_factory.mktemp("proxied"), []
    for schedule in ("faults: []", SCHEDULE):
        autopilot = hover(ARM_US)
        flights.append((flown(folder, autopilot, schedule), autopilot.track))
    return flights[0], flights[1]


def test_the_quad_takes_off_through_the_proxy_with_no_step_lost(pair: tuple[Any, Any]) -> None:
    frames, track = pair[0]
    stamps = zgyro(frames)[:, 0]
    assert np.array_equal(stamps, np.arange(FIRST_US, UNTIL_US + 1, 4000))
    assert track[-1][2] > 2.0  # metres up


def test_a_fault_acts_from_its_start_and_the_vehicle_responds(pair: tuple[Any, Any]) -> None:
    (clean, _), (broken, _) = pair
    difference = zgyro(broken)[:, 1] - zgyro(clean)[:, 1]
    first = np.flatnonzero(difference)[0]
    assert zgyro(broken)[first, 0] == FIRST_US + 3_000_000
    assert difference[first] == pytest.approx(BIAS_RPS, abs=1e-6)


def test_the_same_flight_again_is_the_same_bytes(
    pair: tuple[Any, Any], tmp_path: Path, hover: Any
) -> None:
    again = flown(tmp_path, hover(ARM_US), SCHEDULE)
    assert [f.raw for f in again] == [f.raw for f in pair[1][0]]
