"""The bridge to ArduPilot's SITL: HIL steps in, its outputs back, MAVLink both ways.

ArduPilot's outputs after a line of JSON physics answer the step of that line, so that simulator and
autopilot run in lockstep. Until ArduPilot requests its first line the simulator runs alone.
"""

import select
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mavproxy_fault.ardupilot.autopilot_process import PARAMETER_FILE, start_process
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.ardupilot.fed_autopilot import FedAutopilot
from mavproxy_fault.ardupilot.feeding.companion import set_parameter
from mavproxy_fault.ardupilot.feeding.json_physics import ServoPacket, read_servos
from mavproxy_fault.ardupilot.parameters import VehicleKind, bridge_parameters, check_parameters
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle
from mavproxy_fault.documents.parameter_list import format_parameters
from mavproxy_fault.links.link import Chunk
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.links.udp import UdpServer
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

LOOPBACK = "127.0.0.1"
POLL_S = 0.5  # between checks of the process
END_S = 3.0  # for the autopilot to close its log
STEP_US = 2500  # at 400 Hz: ArduPilot shuts down only while time advances
RADIO_LOST_US = 500_000  # as PX4's COM_RC_LOSS_T
ANSWERS, TELEMETRY = 0, 1  # stream numbers of returned data: a frame never spans both


class BridgedAutopilot(FedAutopilot):
    """ArduPilot's process, which starts after the sensor discovery and ends with this.

    It works in `folder`, with its logs; the user's `overrides` precede the bridge's parameters.
    """

    def __init__(
        self,
        command: Sequence[str],
        vehicle: VehicleKind,
        folder: Path,
        overrides: dict[str, float],
        say: Callable[[str], None],
        hil: str = "the HIL link",
    ) -> None:
        self._sensor_port = TcpServer(LOOPBACK, 0)
        super().__init__(self._sensor_port, vehicle, say, hil)
        check_parameters(overrides)
        self._command, self._overrides, self._folder = list(command), overrides, folder
        self._process: subprocess.Popen[bytes] | None = None
        self._physics, self._mavlink = UdpServer(LOOPBACK, 0), UdpServer(LOOPBACK, 0)
        self._serve: dict[int, Callable[[], None]] = {}
        self._hil_parser, self._parser = Parser(), Parser()
        self._look_s, self._gone = 0.0, False
        self._line: tuple[int, bytes] | None = None  # time and physics of the step to be sent next
        self._sent_us: int | None = None  # time of the step that ArduPilot is processing
        self._line_requested = False  # ArduPilot waits for a line
        self._accepted = -1
        self._radio_us, self._radio_heard = NEVER_US, True  # unless there is a remote control
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def peer_count(self) -> int:
        """1 until the process has ended."""
        # Called at each step, so the process is polled only twice a second.
        if (now_s := time.monotonic()) >= self._look_s:
            self._look_s = now_s + POLL_S
            if not self._gone and (code := self.poll()) is not None:
                self._gone = True
                self._say(f"the autopilot process ended {describe_exit(code)}")
        return int(not self._gone)

    def poll(self) -> int | None:
        """Return the exit code, once the process has ended."""
        return None if self._process is None else self._process.poll()

    def wait(self, timeout: float) -> int:
        """Wait for the exit code, which is 0 if no process was started.

        Raises
        ------
        subprocess.TimeoutExpired
            If it does not end within `timeout` seconds.
        """
        return 0 if self._process is None else self._process.wait(timeout)

    def write(self, data: bytes) -> None:
        """Process bytes of the HIL link, in complete frames."""
        for item in self._hil_parser.push(data, datagram=True):
            if isinstance(item, Frame):
                self.receive(item)

    def read(self) -> list[Chunk]:
        """Return data from ArduPilot.

        Raises
        ------
        ConfigError
            If it does not use the bridge's sensors.
        """
        for descriptor, _ in self._epoll.poll(0):
            self._serve[descriptor]()
        return self.take_answers()

    def close(self) -> None:
        """End the process; it needs further physics while it closes its log."""
        # No process yet if the sensors were refused.
        if self._process is not None:
            self._process.terminate()
            until_s = time.monotonic() + END_S
            while self._process.poll() is None and time.monotonic() < until_s:
                select.select(self._physics.filenos(), [], [], 0.1)
                self._drain()
            self._process.kill()
            self._process.wait()
        for port in (self._physics, self._mavlink, self._sensor):
            port.close()
        self._epoll.close()

    def _start(self, discovered: DiscoveredVehicle) -> None:
        super()._start(discovered)
        rate_hz, battery_v = discovered.rate_hz, discovered.readings.battery_v
        values = bridge_parameters(self._vehicle, rate_hz, discovered.sensors, battery_v)
        values |= self._overrides
        (self._folder / PARAMETER_FILE).write_text(format_parameters(values))
        self._say(f"{self._command[0]}: starting in {self._folder} at {rate_hz:g} steps/s")
        self._process = start_process(
            self._command, self._folder, discovered.home, physics=self._physics.port,
            mavlink=self._mavlink.port, vectornav=self._sensor_port.port,
        )  # fmt: skip
        self._serve = {
            self._physics.filenos()[0]: self._serve_physics,
            self._mavlink.filenos()[0]: self._serve_mavlink,
            self._sensor.filenos()[0]: self._serve_sensor,
        }
        for descriptor in self._serve:
            self._epoll.register(descriptor, select.EPOLLIN)

    def _drain(self) -> None:
        """Repeat the last state with advancing time, so that ArduPilot can shut down."""
        if self._discovered is None or (truth := self._discovered.readings.truth) is None:
            return
        for _ in self._physics.read():
            self._sent_us = (self._sent_us or truth.t_us) + STEP_US
            later = truth._replace(t_us=self._sent_us)
            self._physics.write(self._feed.step(self._discovered.readings, later).physics)

    def _converted(self, frame: Frame) -> bytes | None:
        if frame.layout.name == "RC_CHANNELS":
            self._radio_us = self.t_us
            return None
        if frame.layout.name == "BATTERY_STATUS" and self._discovered is not None:
            voltage_v = self._discovered.readings.battery_v
            return None if voltage_v is None else set_parameter("SIM_BATT_VOLTAGE", voltage_v)
        return super()._converted(frame)

    def _write_mavlink(self, raw: bytes) -> None:
        self._mavlink.write(raw)

    def _end_step(self, discovered: DiscoveredVehicle) -> bytes:
        line = super()._end_step(discovered)
        if (heard := self.t_us - self._radio_us < RADIO_LOST_US) != self._radio_heard:
            # SITL has its own receiver, with the sticks at rest.
            self._radio_heard = heard
            self._mavlink.write(set_parameter("SIM_RC_FAIL", not heard))
        self._line = self.t_us, line
        self._send_step()
        return line

    def _send_step(self) -> None:
        """Send the waiting step if ArduPilot has requested one."""
        if self._line_requested and self._line is not None:
            self._sent_us, line = self._line
            self._line, self._line_requested = None, False
            self._physics.write(line)

    def _serve_physics(self) -> None:
        for _, data in self._physics.read():
            packet = read_servos(data)
            if packet is not None:
                self._take_outputs(packet)

    def _take_outputs(self, packet: ServoPacket) -> None:
        """Process servo outputs: the answer to a step, or a repeated request for the next."""
        # An unchanged count is a repeated request, not the answer to a step.
        if packet.accepted != self._accepted and self._sent_us is not None:
            self._answers.append((ANSWERS, self._actuator_frame(self._sent_us, packet.pwm_us)))
        self._accepted = packet.accepted
        self._line_requested = True
        self._send_step()

    def _serve_mavlink(self) -> None:
        for _, data in self._mavlink.read():
            self._answers.append((TELEMETRY, data))
            for item in self._parser.push(data):
                if isinstance(item, Frame):
                    self._receive_mavlink(item)
