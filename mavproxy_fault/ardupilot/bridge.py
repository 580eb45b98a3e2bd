"""The bridge: HIL steps to ArduPilot, its outputs back, MAVLink both ways.

ArduPilot's outputs after a line of JSON physics answer the step of that line, so that simulator and
autopilot run in lockstep. Until ArduPilot requests its first line the simulator runs alone.
"""

from collections.abc import Callable

from mavproxy_fault.ardupilot.bridge_ports import Datagrams, SensorPort
from mavproxy_fault.ardupilot.feeding.companion import CompanionFeed, set_parameter
from mavproxy_fault.ardupilot.feeding.json_physics import ServoPacket, read_servos
from mavproxy_fault.ardupilot.feeding.sensor_feed import SensorFeed
from mavproxy_fault.ardupilot.outputs import MODE_ARMED, Channels, actuator_frame
from mavproxy_fault.ardupilot.preparation import Preparation
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
RADIO_LOST_US = 500_000  # as PX4's COM_RC_LOSS_T
ANSWERS, TELEMETRY = 0, 1  # stream numbers of returned data: a frame never spans both

ReplyHandler = Callable[[int, bytes], None]


class Bridge:
    """One flight, from the start of the autopilot.

    Parameters
    ----------
    answer : callable
        Sends data back on the HIL link: takes ANSWERS or TELEMETRY, and bytes.
    discovered : DiscoveredVehicle
        Result of the sensor discovery.
    ports : (Datagrams, Datagrams, SensorPort)
        Physics, MAVLink and VectorNav ports to ArduPilot.
    channels : Channels
        Converts outputs to PX4's channels.

    Attributes
    ----------
    steps, t_us : int
        Number of steps, and vehicle time of the last.
    """

    def __init__(
        self,
        answer: ReplyHandler,
        discovered: DiscoveredVehicle,
        ports: tuple[Datagrams, Datagrams, SensorPort],
        channels: Channels,
        say: Callable[[str], None],
    ) -> None:
        self.armed = False
        self.steps = self.t_us = 0
        self._answer = answer
        self._readings = discovered.readings
        self.physics, self._mavlink, self._sensor = ports
        self._channels = channels
        self._say = say
        self._feed = SensorFeed(discovered.home)
        self._companion = CompanionFeed()
        self._preparation = Preparation(discovered.home)
        self._parser = Parser()
        self._seq = 0
        self._line: tuple[int, bytes] | None = None  # time and physics of the step to be sent next
        self._sent_us: int | None = None  # time of the step that ArduPilot is processing
        self._line_requested = False  # ArduPilot waits for a line
        self._accepted = -1
        self._radio_us, self._radio_heard = NEVER_US, True  # unless there is a remote control

    def descriptors(self) -> dict[int, Callable[[], None]]:
        """Return the descriptors of ArduPilot's ports with their handlers."""
        return {
            self.physics.fileno(): self._serve_physics,
            self._mavlink.fileno(): self._serve_mavlink,
            self._sensor.fileno(): self._sensor.serve,
        }

    def drain(self) -> None:
        """Repeat the last state with advancing time, so that ArduPilot can shut down."""
        truth = self._readings.truth
        if truth is None:
            return
        for _ in self.physics.read():
            # 2500 us is a step at 400 Hz: ArduPilot shuts down only while time advances.
            later = truth._replace(t_us=(self._sent_us or truth.t_us) + 2500)
            self._sent_us = later.t_us
            self.physics.write(self._feed.step(self._readings, later).physics)

    def receive(self, frame: Frame) -> None:
        """Process a frame of the HIL link."""
        if self._readings.update(frame):
            self._end_step()
        elif frame.layout.name == "RC_CHANNELS":
            self._radio_us = self.t_us
        elif frame.layout.name == "BATTERY_STATUS":
            if (voltage_v := self._readings.battery_v) is not None:
                self._mavlink.write(set_parameter("SIM_BATT_VOLTAGE", voltage_v))
        elif (raw := self._companion.step(frame, self.t_us)) is not None:
            self._mavlink.write(raw)

    def _end_step(self) -> None:
        truth = self._readings.truth
        if truth is None:
            return
        self.steps, self.t_us = self.steps + 1, truth.t_us
        fed = self._feed.step(self._readings, truth, self._sensor.outputs)
        self._readings.begin_step()
        if (heard := truth.t_us - self._radio_us < RADIO_LOST_US) != self._radio_heard:
            # SITL has its own receiver, with the sticks at rest.
            self._radio_heard = heard
            self._mavlink.write(set_parameter("SIM_RC_FAIL", not heard))
        self._sensor.write(fed.vectornav)
        self._line = truth.t_us, fed.physics
        if (request := self._preparation.due(truth.t_us)) is not None:
            self._mavlink.write(request)
        self._send_step()

    def _send_step(self) -> None:
        """Send the waiting step if ArduPilot has requested one."""
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
        """Process servo outputs: the answer to a step, or a repeated request for the next."""
        # An unchanged count is a repeated request, not the answer to a step.
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
