"""A flight under the eyes of an autopilot on a link: HIL frames go to it, in lockstep.

The simulator's own loop keeps the step; what passes between it and the link goes through the
proxy's core, so that faults act on what the autopilot is told, and on what it says.
"""

import io
import math
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager

from analysis.run.proxied_flight import MONITOR, SIMULATOR, VEHICLE, Flight
from analysis.search.space.test_file import AutopilotChoice
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.app.lockstep_loop import LockstepLoop, PeerGoneError
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import airframe
from simvehicle.hil.hil_frames import Hil
from simvehicle.hil.lockstep import AutopilotSilentError
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Controls, Truth

ENDS_S = 5.0  # how long a process may take to end
Step = tuple[int, Truth, Sequence[Reading]]
Process = subprocess.Popen[bytes]


class LeftError(Exception):
    """The flight is beyond a limit of the envelope."""

    def __init__(self, limit: int) -> None:
        super().__init__(limit)
        self.limit = limit


class _Plane:
    """The loop's simulation: flown by the autopilot or by itself, and watched."""

    def __init__(self, flight: Flight, flies: bool, limit: Callable[[Truth], int]) -> None:
        self._flight, self._flies, self._limit = flight, flies, limit
        self.steps = 0

    def step(self, controls: Controls | None) -> Step:
        """Go on by one step."""
        found = self._flight.simulation.step(controls if self._flies else None)
        self.steps += 1
        limit = self._limit(found[1])
        if limit:
            raise LeftError(limit)
        return found

    def plant(self, name: str, value: float | None) -> None:
        """A change of the plant."""
        self._flight.simulation.plant(name, value)


class _ToAutopilot:
    """The loop's packer: frames as they leave the proxy."""

    def __init__(self, flight: Flight, packer: Hil, hear: Callable[[bytes], None]) -> None:
        self.start_us = packer.start_us
        self._flight, self._packer, self._hear = flight, packer, hear

    def frames(self, t_us: int, truth: Truth, readings: Sequence[Reading]) -> list[bytes]:
        """The frames of a step, with faults."""
        out = []
        for raw in self._packer.frames(t_us, truth, readings):
            for send in self._flight.core.received(SIMULATOR, raw, self._flight.now_us):
                if send.link == VEHICLE:
                    out.append(send.data)
                elif send.link == MONITOR:
                    self._hear(send.data)
        return out


class Patience:
    """Gives up where no autopilot comes."""

    def __init__(self, link: Link, process: Process | None, seconds: float) -> None:
        self._link, self._process, self._seconds = link, process, seconds
        self._deadline = time.monotonic() + seconds

    def check(self) -> None:
        """Raise ConfigError where nobody is there and nobody will come."""
        if self._link.peer_count:
            return
        if self._process is not None and self._process.poll() is not None:
            code = self._process.returncode
            raise ConfigError(f"autopilot.command: it ended with code {code}; it has to connect")
        if time.monotonic() > self._deadline:
            raise ConfigError(
                f"autopilot: nobody came to {self._link.name} within {self._seconds:g} s"
            )


class _FromAutopilot:
    """The loop's inbox: what the autopilot says, on the HIL link and on its telemetry."""

    def __init__(
        self,
        flight: Flight,
        links: Sequence[Link],
        patience: Patience,
        hear: Callable[[bytes], None],
    ) -> None:
        self.link = links[0]
        self._flight, self._patience, self._hear = flight, patience, hear
        self._inboxes = [Inbox(link) for link in links]
        self._parser = Parser()

    def frames(self) -> list[Frame]:
        """What came and left the proxy for the simulator."""
        self._patience.check()
        found = []
        for inbox in self._inboxes:
            for frame in inbox.frames():
                for send in self._flight.core.received(VEHICLE, frame.raw, self._flight.now_us):
                    if send.link == SIMULATOR:
                        items = self._parser.push(send.data, datagram=True)
                        found += [item for item in items if isinstance(item, Frame)]
                    elif send.link == MONITOR:
                        self._hear(send.data)
        return found


class AutopilotFlight(Flight):
    """A scenario flown once with an autopilot on the link."""

    def __init__(
        self,
        scenario: Scenario,
        schedule: Schedule,
        choice: AutopilotChoice,
        hear: Callable[[bytes], None],
    ) -> None:
        super().__init__(scenario, schedule)
        self._choice, self._hear = choice, hear

    def fly(self, limit: Callable[[Truth], int]) -> tuple[int, int]:
        """Fly to the end, or to where `limit` says so: its number (0 for none), and the steps.

        Raises
        ------
        ConfigError
            If no autopilot comes, or it goes.
        """
        mav_type, mix = airframe(self.simulation)
        plane = _Plane(self, self._choice.flies, limit)
        with self._served() as (links, patience):
            loop = LockstepLoop(
                plane,
                _ToAutopilot(self, Hil(mav_type=mav_type), self._hear),
                _FromAutopilot(self, links, patience, self._hear),
                mix,
                math.inf,
                Progress(time.monotonic(), io.StringIO()),
            )
            try:
                loop.run(round(self.duration_s * 1e6))
            except LeftError as left:
                return left.limit, plane.steps
            except (PeerGoneError, AutopilotSilentError) as gone:
                raise ConfigError(f"autopilot: {gone}, {self.t_us * 1e-6:.1f} s on") from gone
        return 0, plane.steps

    @contextmanager
    def _served(self) -> Iterator[tuple[list[Link], Patience]]:
        """The links, and the autopilot started where it is ours to start."""
        choice = self._choice
        with ExitStack() as stack:
            names = [choice.link, *([choice.telemetry] if choice.telemetry else [])]
            links = [stack.enter_context(closing(open_link(name))) for name in names]
            process = None
            if choice.command:
                process = stack.enter_context(started(choice, getattr(links[0], "port", 0)))
            yield links, Patience(links[0], process, choice.start_s)


@contextmanager
def started(choice: AutopilotChoice, port: int) -> Iterator[Process]:
    """The autopilot's process; it is ended in the end.

    Raises
    ------
    ConfigError
        If it cannot be started.
    """
    words = [word.replace("{port}", str(port)) for word in choice.command]
    quiet = subprocess.DEVNULL
    try:
        process = subprocess.Popen(
            words, cwd=choice.folder, stdin=quiet, stdout=quiet, stderr=quiet
        )
    except OSError as error:
        raise ConfigError(f"autopilot.command: {words[0]} cannot be started; {error}") from error
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
