"""ArduPilot on its own board: a VectorNav on one serial port, its MAVLink on another.

There is no lockstep: the board has its own clock. Its outputs arrive as SERVO_OUTPUT_RAW and take
effect on arrival, so the simulator must run in real time.
"""

import select
from collections.abc import Callable

from mavproxy_fault.ardupilot.bridge_ports import SensorPort
from mavproxy_fault.ardupilot.bridged_autopilot import CHANNELS
from mavproxy_fault.ardupilot.feeding.companion import CompanionFeed
from mavproxy_fault.ardupilot.feeding.sensor_feed import SensorFeed
from mavproxy_fault.ardupilot.outputs import CHANNELS as OUTPUTS
from mavproxy_fault.ardupilot.outputs import MODE_ARMED, actuator_frame
from mavproxy_fault.ardupilot.parameters import VehicleKind
from mavproxy_fault.ardupilot.preparation import Preparation, stream_requests
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle, SensorDiscovery
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Chunk, Link, LinkCounters
from mavproxy_fault.wire.frame import Frame

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
SERVOS = [f"servo{output}_raw" for output in range(1, OUTPUTS + 1)]


class WiredAutopilot:
    """The board as a `Link`: it receives HIL frames; its replies and its own MAVLink are read.

    Parameters
    ----------
    vectornav, mavlink : Link
        Links to the board's external AHRS and telemetry ports; closed with this.
    vehicle : {"copter", "plane"}
    say : callable
        Receives status lines for the user.
    hil : str
        The HIL link's name, for messages.
    """

    datagrams = False

    def __init__(
        self,
        vectornav: Link,
        mavlink: Link,
        vehicle: VehicleKind,
        say: Callable[[str], None],
        hil: str,
    ) -> None:
        self.name = "ArduPilot"
        self.counters = LinkCounters(bytes_in=1)
        self.armed = False
        self.steps = self.t_us = 0
        self._sensor, self._mavlink = SensorPort(vectornav), mavlink
        self._inbox = Inbox(mavlink)
        self._channels, self._say = CHANNELS[vehicle], say
        self._discovery = SensorDiscovery(hil)
        self._discovered: DiscoveredVehicle | None = None
        self._answers: list[Chunk] = []
        # Either kind of link has one descriptor that stays valid when devices are replugged.
        self._seq = 0
        self._epoll = select.epoll()
        for fileno in (self._sensor.fileno(), *mavlink.filenos()):
            self._epoll.register(fileno, select.EPOLLIN)

    @property
    def started(self) -> bool:
        """Whether sensor discovery is complete and the board receives data."""
        return self._discovered is not None

    @property
    def peer_count(self) -> int:
        """1 while its MAVLink device is open."""
        return self._mavlink.peer_count

    def poll(self) -> None:
        """Return None: a board has no exit code."""

    def filenos(self) -> list[int]:
        """Return the epoll descriptor of both links."""
        return [self._epoll.fileno()]

    def receive(self, frame: Frame) -> None:
        """Process a frame of the HIL link.

        Raises
        ------
        ConfigError
            If ArduPilot cannot fly on the available sensors.
        """
        if self._discovered is None:
            if (discovered := self._discovery.update(frame)) is not None:
                self._start(discovered)
        elif self._discovered.readings.update(frame):
            self._end_step(self._discovered)
        elif (raw := self._companion.step(frame, self.t_us)) is not None:
            self._mavlink.write(raw)

    def _start(self, discovered: DiscoveredVehicle) -> None:
        self._discovered = discovered
        self._feed = SensorFeed(discovered.home)
        self._companion = CompanionFeed()
        self._preparation = Preparation(discovered.home, stream_requests())
        self._say(f"feeding the board at {discovered.sensors.rate_hz:g} steps/s")

    def _end_step(self, discovered: DiscoveredVehicle) -> None:
        truth = discovered.readings.truth
        if truth is None:
            return
        self.steps, self.t_us = self.steps + 1, truth.t_us
        # The JSON physics is only for SITL: a board needs nothing but its sensors.
        fed = self._feed.step(discovered.readings, truth, self._sensor.outputs)
        self._sensor.write(fed.vectornav)
        discovered.readings.begin_step()
        if (request := self._preparation.due(truth.t_us)) is not None:
            self._mavlink.write(request)

    def read(self) -> list[Chunk]:
        """Return data from the board.

        Raises
        ------
        ConfigError
            If it does not use the VectorNav.
        """
        self._sensor.serve()
        for frame in self._inbox.frames():
            self._receive_mavlink(frame)
        answers, self._answers = self._answers, []
        return answers

    def _receive_mavlink(self, frame: Frame) -> None:
        name = frame.layout.name
        # Before sensor discovery there is no step to answer.
        if name == "SERVO_OUTPUT_RAW":
            if self.started and frame.number("port") == 0:
                self._answer(frame)
            return
        self._answers.append((0, frame.raw))
        if name == "HEARTBEAT" and frame.component == AUTOPILOT:
            self.armed = bool(int(frame.number("base_mode")) & MODE_ARMED)
        if self.started and (waiting := self._preparation.pending):
            self._preparation.received(frame)
            if self._preparation.pending != waiting:
                self._say(f"{waiting}: done")

    def _answer(self, frame: Frame) -> None:
        """Send the outputs as HIL_ACTUATOR_CONTROLS, and unchanged for the monitor."""
        # Only port 0 comes here; port 1 is an extension board without motors.
        pwm_us = [int(frame.number(servo)) for servo in SERVOS]
        self._seq = (self._seq + 1) & 0xFF
        channels = self._channels(pwm_us)
        raw = actuator_frame(self.t_us, channels, self._seq, armed=self.armed)
        self._answers += [(0, frame.raw), (0, raw)]

    def close(self) -> None:
        """Close both links."""
        self._epoll.close()
        self._sensor.close()
        self._mavlink.close()
