"""The multirotor hovers in lockstep on a small stand-in for an autopilot, over real TCP."""

import io
import math
import threading
from pathlib import Path
from typing import Any

import numpy as np

from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from simvehicle.app.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import motor_mix

SCENARIO = """
vehicle: {kind: multirotor, parameters: iris}
environment: {wind_ned_mps: [2.0, -1.0, 0.0]}
sensors: {imu: {preset: consumer-mems, rate_hz: 250}}
"""
UNTIL_US = 12_000_000


def test_the_multirotor_hovers_in_wind_with_controls_from_the_link(
    tmp_path: Path, hover: Any
) -> None:
    path = tmp_path / "quad.yaml"
    path.write_text(SCENARIO)
    link = open_link("tcpin:127.0.0.1:0")
    assert isinstance(link, TcpServer)
    progress = Progress(0.0, io.StringIO())
    simulation = Simulation(read_scenario(path))
    loop = LockstepLoop(
        simulation, HilPacker(simulation.board), Inbox(link), motor_mix(4), math.inf, progress
    )
    codes: list[int] = []
    thread = threading.Thread(
        target=lambda: codes.append(serve_autopilot(loop, progress, UNTIL_US))
    )
    thread.start()
    autopilot = hover()
    autopilot.fly(link.port, UNTIL_US + 1_000_000)
    thread.join(20)
    link.close()
    assert codes == [0]
    last = np.array(autopilot.track)[-500:]  # two seconds
    assert np.abs(last[:, 2] - autopilot.HEIGHT_M).max() < 0.3
    assert np.hypot(last[:, 0], last[:, 1]).max() < 1.5
    assert np.degrees(np.abs(last[:, 3:])).max() < 10.0
