"""ArduPilot behind the bridge as a link: towards whoever steps it, it is what PX4 is."""

import select
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mavproxy_fault.ardupilot.autopilot_process import PARAMETER_FILE, Ports, start_process
from mavproxy_fault.ardupilot.bridge import Bridge
from mavproxy_fault.ardupilot.bridge_ports import Datagrams, SensorPort
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.ardupilot.outputs import motor_channels, plane_channels
from mavproxy_fault.ardupilot.parameters import VehicleKind, bridge_parameters, parameter_file_text
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle, SensorDiscovery
from mavproxy_fault.links.link import Chunk, LinkCounters
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

CHANNELS = {"copter": motor_channels, "plane": plane_channels}
POLL_S = 0.5  # between looks at the program
END_S = 3.0  # for the autopilot to close its log


class BridgedAutopilot:
    """A `Link`: HIL frames are written to it, answers and ArduPilot's own MAVLink read from it.

    The program starts once the first second has shown what the vehicle has.

    Parameters
    ----------
    words : sequence of str
        The program's command.
    vehicle : {"copter", "plane"}
    folder : Path
        Where it runs and leaves its logs.
    own : sequence of Path
        The user's parameter files; they win over the bridge's.
    say : callable
        Takes a line for the person who flies.
    hil : str
        The HIL link's name, for messages.
    """

    datagrams = False

    def __init__(
        self,
        words: Sequence[str],
        vehicle: VehicleKind,
        folder: Path,
        own: Sequence[Path],
        say: Callable[[str], None],
        hil: str = "the HIL link",
    ) -> None:
        self.name = "ArduPilot"
        # It is there from the start: nobody has to wait for a first word.
        self.counters = LinkCounters(bytes_in=1)
        self._bridge: Bridge | None = None  # once the program has started
        self._words, self._vehicle, self._own = list(words), vehicle, list(own)
        self._folder, self._say = folder, say
        self._process: subprocess.Popen[bytes] | None = None
        self._observation = SensorDiscovery(hil)
        self._ports = Datagrams(), Datagrams(), SensorPort()
        self._serve: dict[int, Callable[[], None]] = {}
        self._epoll = select.epoll()
        self._parser = Parser()
        self._answers: list[Chunk] = []
        self._look_s, self._gone = 0.0, False
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def started(self) -> bool:
        """Whether the program was started."""
        return self._bridge is not None

    @property
    def armed(self) -> bool:
        """Whether its motors are on."""
        return self._bridge is not None and self._bridge.armed

    @property
    def steps(self) -> int:
        """How many have come since the program started."""
        return 0 if self._bridge is None else self._bridge.steps

    @property
    def t_us(self) -> int:
        """The vehicle's time of the last step."""
        return 0 if self._bridge is None else self._bridge.t_us

    @property
    def peer_count(self) -> int:
        """1 until the program has ended."""
        # Asked at each step: the system is asked twice a second.
        if (now_s := time.monotonic()) >= self._look_s:
            self._look_s = now_s + POLL_S
            if not self._gone and (code := self.poll()) is not None:
                self._gone = True
                self._say(f"the autopilot's program ended {describe_exit(code)}")
        return int(not self._gone)

    def poll(self) -> int | None:
        """The program's exit code, once it has ended."""
        return None if self._process is None else self._process.poll()

    def wait(self, timeout: float) -> int:
        """The program's exit code, which is 0 where none was started.

        Raises
        ------
        subprocess.TimeoutExpired
            If it does not end within `timeout` seconds.
        """
        return 0 if self._process is None else self._process.wait(timeout)

    def filenos(self) -> list[int]:
        """The epoll descriptor over all that ArduPilot speaks on."""
        return [self._epoll.fileno()]

    def write(self, data: bytes) -> None:
        """Bytes of the HIL link, in whole frames."""
        for item in self._parser.push(data, datagram=True):
            if isinstance(item, Frame):
                self.receive(item)

    def receive(self, frame: Frame) -> None:
        """A frame of the HIL link.

        Raises
        ------
        ConfigError
            If ArduPilot cannot fly on what comes.
        """
        if self._bridge is not None:
            self._bridge.receive(frame)
        elif (seen := self._observation.update(frame)) is not None:
            self._start(seen)

    def read(self) -> list[Chunk]:
        """What ArduPilot has to say.

        Raises
        ------
        ConfigError
            If it does not fly on the bridge's sensors.
        """
        for descriptor, _ in self._epoll.poll(0):
            self._serve[descriptor]()
        # Handed over whole: what comes while they are read belongs to the next time.
        answers, self._answers = self._answers, []
        return answers

    def _start(self, seen: DiscoveredVehicle) -> None:
        # Later files win: the user's stand behind the bridge's.
        file = self._folder / PARAMETER_FILE
        file.write_text(parameter_file_text(bridge_parameters(self._vehicle, seen.sensors)))
        rate_hz = seen.sensors.rate_hz
        self._say(f"{self._words[0]}: starting in {self._folder}, {rate_hz:g} steps a second")
        ports = Ports(*(port.port for port in self._ports))
        self._process = start_process(
            self._words, self._folder, ports, seen.home, [file, *self._own]
        )
        channels = CHANNELS[self._vehicle]
        self._bridge = Bridge(self._answer, seen, self._ports, channels, self._say)
        self._serve = self._bridge.descriptors()
        for descriptor in self._serve:
            self._epoll.register(descriptor, select.EPOLLIN)

    def _answer(self, stream: int, data: bytes) -> None:
        self._answers.append((stream, data))

    def close(self) -> None:
        """End the program: it closes its log while it is still given physics."""
        # Refused before it was started: nothing runs yet.
        if self._process is not None and self._bridge is not None:
            end_process(self._process, self._bridge)
        for port in self._ports:
            port.close()
        self._epoll.close()


def end_process(process: "subprocess.Popen[bytes]", bridge: Bridge) -> None:
    """Ask it to end, and end it."""
    process.terminate()
    until_s = time.monotonic() + END_S
    while process.poll() is None and time.monotonic() < until_s:
        select.select([bridge.physics], [], [], 0.1)
        bridge.drain()
    process.kill()
    process.wait()
