"""The bridge: a step of the HIL link to ArduPilot, its outputs back, MAVLink either way.

ArduPilot's outputs after a line of physics answer the step that the line told, so that simulator
and autopilot are in lockstep. Before ArduPilot asks for its first line the simulator goes on alone.
"""

from collections.abc import Callable

from mavproxy_fault.ardupilot.bridge_ports import Datagrams, SensorPort
from mavproxy_fault.ardupilot.feeding.companion import CompanionFeed
from mavproxy_fault.ardupilot.feeding.json_physics import ServoPacket, read_servos
from mavproxy_fault.ardupilot.feeding.sensor_feed import SensorFeed
from mavproxy_fault.ardupilot.outputs import MODE_ARMED, Channels, actuator_frame
from mavproxy_fault.ardupilot.preparation import Preparation
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
ANSWERS, TELEMETRY = 0, 1  # what goes back, as streams: no frame goes over from one to the other

ReplyHandler = Callable[[int, bytes], None]


class Bridge:
    """One flight, from the autopilot's start on.

    Parameters
    ----------
    answer : callable
        Is given what goes back on the HIL link: ANSWERS or TELEMETRY, and bytes.
    seen : Seen
        What it has told so far.
    ports : (Datagrams, Datagrams, SensorPort)
        Physics, MAVLink and the VectorNav, towards ArduPilot.
    channels : Channels
        Outputs to PX4's channels.

    Attributes
    ----------
    steps, t_us : int
        How many came, and the vehicle's time of the last.
    """

    def __init__(
        self,
        answer: ReplyHandler,
        seen: DiscoveredVehicle,
        ports: tuple[Datagrams, Datagrams, SensorPort],
        channels: Channels,
        say: Callable[[str], None],
    ) -> None:
        self.armed = False
        self.steps = self.t_us = 0
        self._answer = answer
        self._readings = seen.readings
        self.physics, self._mavlink, self._sensor = ports
        self._channels = channels
        self._say = say
        self._feed = SensorFeed(seen.home)
        self._companion = CompanionFeed()
        self._preparation = Preparation(seen.home)
        self._parser = Parser()
        self._seq = 0
        self._line: tuple[int, bytes] | None = None  # stamp and physics of a step yet to be sent
        self._sent_us: int | None = None  # the stamp of the step that ArduPilot works on
        self._line_requested = False  # ArduPilot waits for a line
        self._accepted = -1

    def descriptors(self) -> dict[int, Callable[[], None]]:
        """What to wait for towards ArduPilot, and what serves it."""
        return {
            self.physics.fileno(): self._serve_physics,
            self._mavlink.fileno(): self._serve_mavlink,
            self._sensor.fileno(): self._sensor.serve,
        }

    def drain(self) -> None:
        """Answer ArduPilot with the last state, a step later each time, so that it can end."""
        truth = self._readings.truth
        if truth is None:
            return
        for _ in self.physics.read():
            # 2500 us are a step at 400 Hz: ArduPilot gets to its end only while time goes on.
            later = truth._replace(t_us=(self._sent_us or truth.t_us) + 2500)
            self._sent_us = later.t_us
            self.physics.write(self._feed.step(self._readings, later).physics)

    def receive(self, frame: Frame) -> None:
        """A frame of the HIL link."""
        if self._readings.update(frame):
            self._end_step()
        elif (raw := self._companion.step(frame, self.t_us)) is not None:
            self._mavlink.write(raw)

    def _end_step(self) -> None:
        truth = self._readings.truth
        if truth is None:
            return
        self.steps, self.t_us = self.steps + 1, truth.t_us
        fed = self._feed.step(self._readings, truth, self._sensor.outputs)
        self._readings.begin_step()
        self._sensor.write(fed.vectornav)
        self._line = truth.t_us, fed.physics
        if (request := self._preparation.due(truth.t_us)) is not None:
            self._mavlink.write(request)
        self._send_step()

    def _send_step(self) -> None:
        """Answer ArduPilot's request by the step that waits, if there are both."""
        if self._line_requested and self._line is not None:
            self._sent_us, line = self._line
            self._line, self._line_requested = None, False
            self.physics.write(line)

    def _serve_physics(self) -> None:
        for data in self.physics.read():
            packet = read_servos(data)
            if packet is not None:
                self._outputs(packet)

    def _outputs(self, packet: ServoPacket) -> None:
        """ArduPilot has worked a step off, or asks again for the next one."""
        # An unchanged count is a request repeated, not an answer to a step.
        if packet.accepted != self._accepted and self._sent_us is not None:
            channels = self._channels(packet.pwm_us)
            raw = actuator_frame(self._sent_us, channels, self._next(), armed=self.armed)
            self._answer(ANSWERS, raw)
        self._accepted = packet.accepted
        self._line_requested = True
        self._send_step()

    def _serve_mavlink(self) -> None:
        for data in self._mavlink.read():
            self._answer(TELEMETRY, data)
            for item in self._parser.push(data):
                if isinstance(item, Frame):
                    self._receive_mavlink(item)

    def _receive_mavlink(self, frame: Frame) -> None:
        if frame.layout.name == "HEARTBEAT" and frame.component == AUTOPILOT:
            self.armed = bool(int(frame.number("base_mode")) & MODE_ARMED)
        if waiting := self._preparation.pending:
            self._preparation.received(frame)
            if self._preparation.pending != waiting:
                self._say(f"{waiting}: done")

    def _next(self) -> int:
        self._seq = (self._seq + 1) & 0xFF
        return self._seq
