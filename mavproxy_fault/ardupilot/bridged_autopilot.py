"""ArduPilot behind the bridge, as a link that behaves like PX4."""

import select
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mavproxy_fault.ardupilot.autopilot_process import PARAMETER_FILE, Ports, start_process
from mavproxy_fault.ardupilot.bridge import Bridge
from mavproxy_fault.ardupilot.bridge_ports import Datagrams, SensorPort
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.ardupilot.outputs import motor_channels, plane_channels
from mavproxy_fault.ardupilot.parameters import VehicleKind, bridge_parameters, check_parameters
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle, SensorDiscovery
from mavproxy_fault.documents.parameter_list import format_parameters
from mavproxy_fault.links.link import Chunk, LinkCounters
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

CHANNELS = {"copter": motor_channels, "plane": plane_channels}
POLL_S = 0.5  # between checks of the process
END_S = 3.0  # for the autopilot to close its log


class BridgedAutopilot:
    """A `Link`: HIL frames are written to it, replies and ArduPilot's own MAVLink read from it.

    The process starts after one second of sensor discovery.

    Parameters
    ----------
    command : sequence of str
        The command and its arguments.
    vehicle : {"copter", "plane"}
    folder : Path
        Working folder of the process, with its logs.
    overrides : mapping of str
        The user's parameters; they override the bridge's.
    say : callable
        Receives status lines for the user.
    hil : str
        The HIL link's name, for messages.
    """

    datagrams = False

    def __init__(
        self,
        command: Sequence[str],
        vehicle: VehicleKind,
        folder: Path,
        overrides: Mapping[str, float],
        say: Callable[[str], None],
        hil: str = "the HIL link",
    ) -> None:
        self.name = "ArduPilot"
        # Counts as connected from the start: the caller need not wait for a first message.
        self.counters = LinkCounters(bytes_in=1)
        self._bridge: Bridge | None = None  # once the process has started
        check_parameters(overrides)
        self._command, self._vehicle, self._overrides = list(command), vehicle, overrides
        self._folder, self._say = folder, say
        self._process: subprocess.Popen[bytes] | None = None
        self._discovery = SensorDiscovery(hil)
        self._ports = Datagrams(), Datagrams(), SensorPort()
        self._serve: dict[int, Callable[[], None]] = {}
        self._epoll = select.epoll()
        self._parser = Parser()
        self._answers: list[Chunk] = []
        self._look_s, self._gone = 0.0, False
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def started(self) -> bool:
        """Whether the process was started."""
        return self._bridge is not None

    @property
    def armed(self) -> bool:
        """Whether the vehicle is armed."""
        return self._bridge is not None and self._bridge.armed

    @property
    def steps(self) -> int:
        """Number of steps since the process started."""
        return 0 if self._bridge is None else self._bridge.steps

    @property
    def t_us(self) -> int:
        """Vehicle time of the last step."""
        return 0 if self._bridge is None else self._bridge.t_us

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

    def filenos(self) -> list[int]:
        """Return the epoll descriptor of all ArduPilot's sockets."""
        return [self._epoll.fileno()]

    def write(self, data: bytes) -> None:
        """Process bytes of the HIL link, in complete frames."""
        for item in self._parser.push(data, datagram=True):
            if isinstance(item, Frame):
                self.receive(item)

    def receive(self, frame: Frame) -> None:
        """Process a frame of the HIL link.

        Raises
        ------
        ConfigError
            If ArduPilot cannot fly on the available sensors.
        """
        if self._bridge is not None:
            self._bridge.receive(frame)
        elif (discovered := self._discovery.update(frame)) is not None:
            self._start(discovered)

    def read(self) -> list[Chunk]:
        """Return data from ArduPilot.

        Raises
        ------
        ConfigError
            If it does not use the bridge's sensors.
        """
        for descriptor, _ in self._epoll.poll(0):
            self._serve[descriptor]()
        # Swapped, so that later answers belong to the next call.
        answers, self._answers = self._answers, []
        return answers

    def _start(self, discovered: DiscoveredVehicle) -> None:
        values = bridge_parameters(self._vehicle, discovered.sensors) | self._overrides
        (self._folder / PARAMETER_FILE).write_text(format_parameters(values))
        rate_hz = discovered.sensors.rate_hz
        self._say(f"{self._command[0]}: starting in {self._folder} at {rate_hz:g} steps/s")
        ports = Ports(*(port.port for port in self._ports))
        self._process = start_process(self._command, self._folder, ports, discovered.home)
        channels = CHANNELS[self._vehicle]
        self._bridge = Bridge(self._answer, discovered, self._ports, channels, self._say)
        self._serve = self._bridge.descriptors()
        for descriptor in self._serve:
            self._epoll.register(descriptor, select.EPOLLIN)

    def _answer(self, stream: int, data: bytes) -> None:
        self._answers.append((stream, data))

    def close(self) -> None:
        """End the process; it needs further physics while it closes its log."""
        # No process yet if the sensors were refused.
        if self._process is not None and self._bridge is not None:
            end_process(self._process, self._bridge)
        for port in self._ports:
            port.close()
        self._epoll.close()


def end_process(process: "subprocess.Popen[bytes]", bridge: Bridge) -> None:
    """Terminate the process, and kill it if it does not end in time."""
    process.terminate()
    until_s = time.monotonic() + END_S
    while process.poll() is None and time.monotonic() < until_s:
        select.select([bridge.physics], [], [], 0.1)
        bridge.drain()
    process.kill()
    process.wait()
