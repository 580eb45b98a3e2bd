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

from analysis.autopilots.hil_exchange import FromAutopilot, Patience, ToAutopilot
from analysis.autopilots.program import Process, ended
from analysis.run.proxied_flight import MONITOR, Flight
from analysis.search.space.test_file import AutopilotChoice
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.schedule.entries import Schedule
from simvehicle.app.lockstep_loop import LockstepLoop, PeerGoneError
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import airframe
from simvehicle.hil.hil_frames import Hil
from simvehicle.hil.lockstep import AutopilotSilentError, Lockstep
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Controls, Truth

ENDS_S = 5.0  # how long a process may take to end
Step = tuple[int, Truth, Sequence[Reading]]


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
        # The autopilot is fed either way; only with `flies` do its actuators count.
        found = self._flight.simulation.step(controls if self._flies else None)
        self.steps += 1
        limit = self._limit(found[1])
        if limit:
            # An exception, since the loop that is shared with the simulator knows no envelope.
            raise LeftError(limit)
        return found

    def plant(self, name: str, value: float | None) -> None:
        """A change of the plant."""
        self._flight.simulation.plant(name, value)


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
            # Shared by both directions of the link: one sends the step, the other hears the answer.
            lockstep = Lockstep()
            outward = ToAutopilot(self, Hil(mav_type=mav_type), self._heard)
            loop = LockstepLoop(
                plane,
                outward,
                FromAutopilot(outward, links, patience, lockstep),
                mix,
                # As fast as the autopilot answers.
                math.inf,
                # Nobody reads the progress of one flight among many.
                Progress(time.monotonic(), io.StringIO()),
                lockstep,
            )
            try:
                loop.run(round(self.duration_s * 1e6))
            except LeftError as error:
                return error.limit, plane.steps
            except (PeerGoneError, AutopilotSilentError) as gone:
                raise ConfigError(f"autopilot: {gone}, {self.t_us * 1e-6:.1f} s on") from gone
        return 0, plane.steps

    def _heard(self, sends: list[Send]) -> None:
        # The estimator sees what left for the monitor, faults included.
        for send in sends:
            if send.link == MONITOR:
                self._hear(send.data)

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
    # Port 0 is bound by now: the command is told the number it became.
    words = [word.replace("{port}", str(port)) for word in choice.command]
    quiet = subprocess.DEVNULL
    try:
        process = subprocess.Popen(
            words, cwd=choice.folder, stdin=quiet, stdout=quiet, stderr=quiet
        )
    except OSError as error:
        raise ConfigError(f"autopilot.command: {words[0]} cannot be started; {error}") from error
    with ended(process, ENDS_S):
        yield process
