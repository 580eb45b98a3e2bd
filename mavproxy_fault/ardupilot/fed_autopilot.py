"""What ArduPilot in SITL and on a board share: a `Link` that takes HIL frames and answers as PX4.

After a second of sensor discovery HIL steps feed its drivers; its outputs and MAVLink are read.
"""

import select
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from mavproxy_fault.ardupilot.feeding.companion import CompanionFeed
from mavproxy_fault.ardupilot.feeding.sensor_feed import SensorFeed
from mavproxy_fault.ardupilot.feeding.vectornav_handshake import Handshake
from mavproxy_fault.ardupilot.outputs import (
    MODE_ARMED,
    actuator_frame,
    motor_channels,
    plane_channels,
)
from mavproxy_fault.ardupilot.parameters import VehicleKind
from mavproxy_fault.ardupilot.preparation import Preparation, SetupRequest
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle, SensorDiscovery
from mavproxy_fault.links.link import Chunk, Link, LinkCounters
from mavproxy_fault.wire.frame import Frame

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
CHANNELS = {"copter": motor_channels, "plane": plane_channels}


class FedAutopilot(ABC):
    """ArduPilot fed by HIL frames.

    `sensor` is the serial device of its VectorNav, closed with it; `say` receives status lines,
    `hil` names the HIL link in messages, and `requests` go out before the standard ones. `steps`
    counts those since the discovery, `t_us` is the vehicle time of the last.
    """

    datagrams = False

    def __init__(
        self,
        sensor: Link,
        vehicle: VehicleKind,
        say: Callable[[str], None],
        hil: str,
        requests: Sequence[SetupRequest] = (),
    ) -> None:
        self.name = "ArduPilot"
        # Counts as connected from the start: the caller need not wait for a first message.
        self.counters = LinkCounters(bytes_in=1)
        self.armed = False
        self.steps = self.t_us = 0
        self._sensor, self._handshake = sensor, Handshake()
        self._say, self._requests = say, requests
        self._vehicle, self._channels = vehicle, CHANNELS[vehicle]
        self._discovery = SensorDiscovery(hil)
        self._discovered: DiscoveredVehicle | None = None
        self._seq = 0
        self._answers: list[Chunk] = []
        self._epoll = select.epoll()

    @property
    def started(self) -> bool:
        """Whether sensor discovery is complete and ArduPilot receives data."""
        return self._discovered is not None

    def filenos(self) -> list[int]:
        """Return the epoll descriptor of all ArduPilot's ports."""
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
        elif (raw := self._converted(frame)) is not None:
            self._write_mavlink(raw)

    def take_answers(self) -> list[Chunk]:
        """Return and clear what ArduPilot has sent."""
        answers, self._answers = self._answers, []
        return answers

    def _start(self, discovered: DiscoveredVehicle) -> None:
        """Begin to feed the discovered sensors."""
        self._discovered = discovered
        self._feed, self._companion = SensorFeed(discovered.home), CompanionFeed()
        self._preparation = Preparation(discovered.home, self._requests)

    def _converted(self, frame: Frame) -> bytes | None:
        """The frame that ArduPilot reads as MAVLink in place of one of the HIL link."""
        return self._companion.step(frame, self.t_us)

    @abstractmethod
    def _write_mavlink(self, raw: bytes) -> None:
        """Send a frame to ArduPilot's MAVLink port."""

    def _end_step(self, discovered: DiscoveredVehicle) -> bytes:
        """Feed a step to the VectorNav, and return its line of JSON physics."""
        readings, truth = discovered.readings, discovered.readings.truth
        assert truth is not None, "the truth ends a step"
        self.steps, self.t_us = self.steps + 1, truth.t_us
        fed = self._feed.step(readings, truth, self._handshake.outputs)
        readings.begin_step()
        if fed.vectornav:
            self._sensor.write(fed.vectornav)
        if (request := self._preparation.due(truth.t_us)) is not None:
            self._write_mavlink(request)
        return fed.physics

    def _serve_sensor(self) -> None:
        """Reply to the commands of the VectorNav's driver."""
        for _, data in self._sensor.read():
            if data:
                self._sensor.write(self._handshake.received(data))
            else:
                self._handshake = Handshake()  # a new connection configures the sensor again

    def _receive_mavlink(self, frame: Frame) -> None:
        """Read whether it is armed, and its answers to the setup requests."""
        if frame.layout.name == "HEARTBEAT" and frame.component == AUTOPILOT:
            self.armed = bool(int(frame.number("base_mode")) & MODE_ARMED)
        if self.started and (waiting := self._preparation.pending):
            self._preparation.received(frame)
            if self._preparation.pending != waiting:
                self._say(f"{waiting}: done")

    def _actuator_frame(self, stamp_us: int, pwm_us: Sequence[int]) -> bytes:
        """The answer to the step at `stamp_us` by servo outputs."""
        self._seq = (self._seq + 1) & 0xFF
        return actuator_frame(stamp_us, self._channels(pwm_us), self._seq, armed=self.armed)
