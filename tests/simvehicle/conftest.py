"""A small stand-in for an autopilot on the HIL link."""

import math
import socket

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.numerics.rotations.rotation import euler_from_quat

# Front right, rear left, front left, rear right: signs of roll right, pitch up and yaw right.
ROLL = np.array([-1.0, 1.0, 1.0, -1.0])
PITCH = np.array([1.0, -1.0, 1.0, -1.0])
YAW = np.array([1.0, 1.0, -1.0, -1.0])
M_PER_DEGE7 = 0.0111


class Hover:
    """Holds height, position and heading by the truth from the simulator; gains tuned by hand.

    Until `arm_us` it answers unarmed, as PX4 does while it starts; `heard` is what it was sent.
    """

    HEIGHT_M = 5.0

    def __init__(self, arm_us: int = 0) -> None:
        self.arm_us = arm_us
        self.heard = b""
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
        above = self.HEIGHT_M - height
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

    def fly(self, port: int, until_us: int) -> None:
        """Answer each HIL_SENSOR with controls for the truth of the step before."""
        mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        reader = dialect.MAVLink(None)
        command = [0.0] * 4
        with socket.create_connection(("127.0.0.1", port), timeout=60) as sock:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.sendall(mav.heartbeat_encode(0, 12, 0, 0, 0).pack(mav))
            while data := sock.recv(65536):
                self.heard += data
                for message in reader.parse_buffer(data) or []:
                    if message.get_type() == "HIL_STATE_QUATERNION":
                        command = self.motors(message)
                        if message.time_usec >= until_us:
                            return
                    elif message.get_type() == "HIL_SENSOR":
                        armed = message.time_usec >= self.arm_us
                        values = [*(command if armed else [0.0] * 4), *[0.0] * 12]
                        mode = 129 if armed else 1
                        answer = mav.hil_actuator_controls_encode(
                            message.time_usec, values, mode, 1
                        )
                        sock.sendall(answer.pack(mav))


@pytest.fixture(scope="session")
def hover() -> type[Hover]:
    """A small stand-in for PX4."""
    return Hover
