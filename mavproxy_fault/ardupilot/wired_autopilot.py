"""ArduPilot on its own board: a VectorNav on one serial port, its MAVLink on another.

There is no lockstep: the board has its own clock. Its outputs arrive as SERVO_OUTPUT_RAW and take
effect on arrival, so the simulator must run in real time.
"""

import select
from collections.abc import Callable

from mavproxy_fault.ardupilot.fed_autopilot import FedAutopilot
from mavproxy_fault.ardupilot.outputs import CHANNELS as OUTPUTS
from mavproxy_fault.ardupilot.parameters import VehicleKind
from mavproxy_fault.ardupilot.preparation import stream_requests
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Chunk, Link
from mavproxy_fault.wire.frame import Frame

SERVOS = [f"servo{output}_raw" for output in range(1, OUTPUTS + 1)]


class WiredAutopilot(FedAutopilot):
    """The board; `vectornav` and `mavlink` are links to its external AHRS and telemetry ports,
    closed with it."""

    def __init__(
        self,
        vectornav: Link,
        mavlink: Link,
        vehicle: VehicleKind,
        say: Callable[[str], None],
        hil: str,
    ) -> None:
        super().__init__(vectornav, vehicle, say, hil, stream_requests())
        self._mavlink, self._inbox = mavlink, Inbox(mavlink)
        # Either kind of link has one descriptor that stays valid when devices are replugged.
        for fileno in (*vectornav.filenos(), *mavlink.filenos()):
            self._epoll.register(fileno, select.EPOLLIN)

    @property
    def peer_count(self) -> int:
        """1 while its MAVLink device is open."""
        return self._mavlink.peer_count

    def poll(self) -> None:
        """Return None: a board has no exit code."""

    def read(self) -> list[Chunk]:
        """Return data from the board.

        Raises
        ------
        ConfigError
            If it does not use the VectorNav.
        """
        self._serve_sensor()
        for frame in self._inbox.frames():
            self._receive_mavlink(frame)
        return self.take_answers()

    def close(self) -> None:
        """Close both links."""
        self._epoll.close()
        self._sensor.close()
        self._mavlink.close()

    def _start(self, discovered: DiscoveredVehicle) -> None:
        super()._start(discovered)
        self._say(f"feeding the board at {discovered.rate_hz:g} steps/s")

    def _write_mavlink(self, raw: bytes) -> None:
        self._mavlink.write(raw)

    def _receive_mavlink(self, frame: Frame) -> None:
        if frame.layout.name != "SERVO_OUTPUT_RAW":
            self._answers.append((0, frame.raw))
            super()._receive_mavlink(frame)
        # Before sensor discovery there is no step to answer; port 1 is an extension board.
        elif self.started and frame.number("port") == 0:
            pwm_us = [int(frame.number(servo)) for servo in SERVOS]
            # Also unchanged, for the monitor.
            self._answers += [(0, frame.raw), (0, self._actuator_frame(self.t_us, pwm_us))]
