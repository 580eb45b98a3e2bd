"""The bridge's loop: a step of the HIL link to ArduPilot, its outputs back, MAVLink either way.

ArduPilot's outputs after a line of physics answer the step that the line told, so that simulator
and autopilot are in lockstep. Before ArduPilot asks for its first line the simulator goes on alone.
"""

import select
import time
from collections.abc import Callable
from typing import Protocol

from mavproxy_fault.ardupilot.bridge_ports import Datagrams, SensorPort
from mavproxy_fault.ardupilot.child_process import ending
from mavproxy_fault.ardupilot.companion import for_ardupilot
from mavproxy_fault.ardupilot.json_physics import ServoPacket, read_servos
from mavproxy_fault.ardupilot.observation import Seen
from mavproxy_fault.ardupilot.outputs import MODE_ARMED, Channels, actuator_frame
from mavproxy_fault.ardupilot.preparation import Preparation
from mavproxy_fault.ardupilot.sensor_feed import SensorFeed
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

WAIT_S = 0.5  # between looks at the autopilot's process
SILENCE_S = 5.0  # without a step, after which it is told
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1


class FlightEndError(RuntimeError):
    """A partner of the bridge went away; `in_flight` tells whether the vehicle was armed."""

    def __init__(self, reason: str, *, in_flight: bool) -> None:
        super().__init__(reason)
        self.in_flight = in_flight


class Process(Protocol):
    """What the loop needs of the autopilot's program; `subprocess.Popen` is one."""

    def poll(self) -> int | None:
        """Its exit code, once it has ended."""


class Bridge:
    """One flight, from the autopilot's start to the end of either side.

    Parameters
    ----------
    inbox : Inbox
        The HIL link.
    seen : Seen
        What it has told so far.
    ports : (Datagrams, Datagrams, SensorPort)
        Physics, MAVLink and the VectorNav, towards ArduPilot.
    channels : Channels
        Outputs to PX4's channels.
    """

    def __init__(
        self,
        inbox: Inbox,
        seen: Seen,
        ports: tuple[Datagrams, Datagrams, SensorPort],
        channels: Channels,
        say: Callable[[str], None],
        silence_s: float = SILENCE_S,
    ) -> None:
        self.armed = False
        self._inbox = inbox
        self._readings = seen.readings
        self.physics, self._mavlink, self._sensor = ports
        self._channels = channels
        self._say = say
        self._silence_s = silence_s
        self._feed = SensorFeed(seen.home)
        self._preparation = Preparation(seen.home)
        self._parser = Parser()
        self._seq = 0
        self._line: tuple[int, bytes] | None = None  # stamp and physics of a step yet to be sent
        self._sent_us: int | None = None  # the stamp of the step that ArduPilot works on
        self._asked = False  # ArduPilot waits for a line
        self._accepted = -1
        self._stepped = True  # since the last look
        self._silent_s: float | None = None  # when the last step was seen; None once it is told

    def run(self, process: Process) -> None:
        """Carry steps until a side goes away.

        Raises
        ------
        FlightEndError
            With what went away and when.
        ConfigError
            If the autopilot does not fly on the bridge's sensors.
        """
        serve = {
            self._inbox.link.fileno(): self._serve_hil,
            self.physics.fileno(): self._serve_physics,
            self._mavlink.fileno(): self._serve_mavlink,
            self._sensor.fileno(): self._sensor.serve,
        }
        poll = select.epoll()
        for descriptor in serve:
            poll.register(descriptor, select.EPOLLIN)
        look_s = 0.0
        with poll:
            while True:
                for descriptor, _ in poll.poll(WAIT_S):
                    serve[descriptor]()
                if not self._inbox.link.peer_count:
                    raise self._ended(f"{self._inbox.link.name}: the HIL link was closed")
                if (now_s := time.monotonic()) >= look_s:
                    look_s = now_s + WAIT_S
                    if (code := process.poll()) is not None:
                        raise self._ended(f"the autopilot's program ended {ending(code)}")
                    self._watch_silence(now_s)

    def _watch_silence(self, now_s: float) -> None:
        """Tell once that no step comes: the simulator may have died behind a proxy."""
        if self._stepped:
            self._stepped, self._silent_s = False, now_s
        elif self._silent_s is not None and now_s - self._silent_s > self._silence_s:
            self._say(f"{self._inbox.link.name}: no step for {self._silence_s:g} s; still waiting")
            self._silent_s = None

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

    def _serve_hil(self) -> None:
        for frame in self._inbox.frames():
            if self._readings.update(frame):
                self._end_step()
            elif (raw := for_ardupilot(frame)) is not None:
                self._mavlink.write(raw)

    def _end_step(self) -> None:
        truth = self._readings.truth
        if truth is None:
            return
        self._stepped = True
        fed = self._feed.step(self._readings, truth)
        self._readings.begin_step()
        self._sensor.write(fed.vectornav)
        self._line = truth.t_us, fed.physics
        if (request := self._preparation.due(truth.t_us)) is not None:
            self._mavlink.write(request)
        self._send_step()

    def _send_step(self) -> None:
        """Answer ArduPilot's request by the step that waits, if there are both."""
        if self._asked and self._line is not None:
            self._sent_us, line = self._line
            self._line, self._asked = None, False
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
            self._inbox.link.write(
                actuator_frame(self._sent_us, channels, self._next(), armed=self.armed)
            )
        self._accepted = packet.accepted
        self._asked = True
        self._send_step()

    def _serve_mavlink(self) -> None:
        for data in self._mavlink.read():
            self._inbox.link.write(data)
            for item in self._parser.push(data):
                if isinstance(item, Frame):
                    self._heard(item)

    def _heard(self, frame: Frame) -> None:
        if frame.layout.name == "HEARTBEAT" and frame.component == AUTOPILOT:
            self.armed = bool(int(frame.number("base_mode")) & MODE_ARMED)
        if waiting := self._preparation.pending:
            self._preparation.received(frame)
            if self._preparation.pending != waiting:
                self._say(f"{waiting}: done")

    def _ended(self, reason: str) -> FlightEndError:
        """The error that says what ended the flight, and when."""
        truth = self._readings.truth
        at_s = 0.0 if truth is None else truth.t_us * 1e-6
        flying = ", in flight" if self.armed else ""
        return FlightEndError(
            f"{reason} at {at_s:.3f} s of vehicle time{flying}", in_flight=self.armed
        )

    def _next(self) -> int:
        self._seq = (self._seq + 1) & 0xFF
        return self._seq
