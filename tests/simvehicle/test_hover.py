"""The multirotor hovers in lockstep on a small stand-in for an autopilot, over real TCP."""

import io
import math
import socket
import threading
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from simvehicle.actuators import motors
from simvehicle.hil import Hil
from simvehicle.inbox import Inbox
from simvehicle.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.progress import Progress
from simvehicle.rotation import euler_from_quat
from simvehicle.scenario import read_scenario
from simvehicle.simulation import Simulation

SCENARIO = """
vehicle: {kind: multirotor, parameters: iris}
environment: {wind_ned_mps: [2.0, -1.0, 0.0]}
sensors: {imu: {preset: consumer-mems, rate_hz: 250}}
"""
# Front right, rear left, front left, rear right: what turns right, pitches up and yaws right.
ROLL = np.array([-1.0, 1.0, 1.0, -1.0])
PITCH = np.array([1.0, -1.0, 1.0, -1.0])
YAW = np.array([1.0, 1.0, -1.0, -1.0])
HEIGHT_M, M_PER_DEGE7 = 5.0, 0.0111
UNTIL_US = 12_000_000


class Hover:
    """Holds height, place and heading by the truth the simulator sends; gains by hand."""

    def __init__(self) -> None:
        self.home: tuple[int, int, int] | None = None
        self.lift = 0.6
        self.drift = np.zeros(2)
        self.track: list[tuple[float, ...]] = []

    def motors(self, state: dialect.MAVLink_message) -> list[float]:
        self.home = self.home or (state.lat, state.lon, state.alt)
        roll, pitch, yaw = euler_from_quat(state.attitude_quaternion).tolist()
        scale = np.array([1.0, math.cos(math.radians(47.4))]) * M_PER_DEGE7
        place = (np.array([state.lat, state.lon]) - self.home[:2]) * scale
        height = (state.alt - self.home[2]) * 1e-3
        self.track.append((*place, height, roll, pitch))
        above = HEIGHT_M - height
        self.lift += 0.0004 * max(min(above, 1.0), -1.0)
        thrust = self.lift + 0.1 * max(min(above, 1.5), -1.5) + 0.12 * state.vz * 1e-2
        self.drift = np.clip(self.drift + 0.0001 * place, -0.3, 0.3)
        pull = 0.08 * place + 0.15 * np.array([state.vx, state.vy]) * 1e-2 + self.drift
        lean = np.clip(pull, -0.35, 0.35)
        turn = 0.14 * (-lean[1] - roll) - 0.036 * state.rollspeed
        nose = 0.14 * (lean[0] - pitch) - 0.036 * state.pitchspeed
        spin = -0.1 * yaw - 0.15 * state.yawspeed
        mixed = thrust + turn * ROLL + nose * PITCH + spin * YAW
        return np.clip(mixed, 0.02, 1.0).tolist()


def fly(port: int, autopilot: Hover) -> None:
    """Answer each HIL_SENSOR by what the truth of the step before asks for."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    reader = dialect.MAVLink(None)
    command = [0.0] * 4
    with socket.create_connection(("127.0.0.1", port), timeout=60) as sock:
        sock.sendall(mav.heartbeat_encode(0, 12, 0, 0, 0).pack(mav))
        while data := sock.recv(65536):
            for message in reader.parse_buffer(data) or []:
                if message.get_type() == "HIL_STATE_QUATERNION":
                    command = autopilot.motors(message)
                elif message.get_type() == "HIL_SENSOR":
                    values = [*command, *[0.0] * 12]
                    answer = mav.hil_actuator_controls_encode(message.time_usec, values, 129, 1)
                    sock.sendall(answer.pack(mav))
                    if message.time_usec >= UNTIL_US + 1_000_000:
                        return


def test_the_multirotor_hovers_in_wind_on_controls_that_come_over_the_link(tmp_path: Path) -> None:
    path = tmp_path / "quad.yaml"
    path.write_text(SCENARIO)
    link = open_link("tcpin:127.0.0.1:0")
    assert isinstance(link, TcpServer)
    progress = Progress(0.0, io.StringIO())
    simulation = Simulation(read_scenario(path))
    loop = LockstepLoop(simulation, Hil(), Inbox(link), motors(4), math.inf, progress)
    codes: list[int] = []
    thread = threading.Thread(
        target=lambda: codes.append(serve_autopilot(loop, progress, UNTIL_US))
    )
    thread.start()
    autopilot = Hover()
    fly(link.port, autopilot)
    thread.join(20)
    link.close()
    assert codes == [0]
    last = np.array(autopilot.track)[-500:]  # two seconds
    assert np.abs(last[:, 2] - HEIGHT_M).max() < 0.3
    assert np.hypot(last[:, 0], last[:, 1]).max() < 1.5
    assert np.degrees(np.abs(last[:, 3:])).max() < 10.0
