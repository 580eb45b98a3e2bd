"""An autopilot's program in flight: its process, where it is heard, and how it ended."""

import contextlib
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.autopilots.hil_exchange import StepMessage, WaitableProcess
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.links.link import Link
from simvehicle.app.pace import Pace

MIN_WAIT_S = 0.02  # wall time by which the flight may be ahead of its pace
STARTUP_SPEED = 4.0  # times real time: slower the flight waits for the start, faster it holds it up
STARTUP_LIMIT_S = 60.0
SHUTDOWN_TIMEOUT_S = 10.0  # for a program to close its logs

Process = subprocess.Popen[bytes]


@dataclass(frozen=True, slots=True)
class RunningAutopilot:
    """What flies, the log of what it says on its console, and the message that steps it.

    The first link is the HIL link, further ones are its telemetry. `startup_text` are words of the
    console that end its start, while which it already answers.
    """

    name: str
    process: WaitableProcess
    links: Sequence[Link]
    log: Path
    step_message: StepMessage
    startup_text: str = ""

    def exit_details(self) -> str:
        """How it ended where it was killed, else what it said last; for a message."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            if (code := self.process.wait(SHUTDOWN_TIMEOUT_S)) < 0:
                return f"; {self.name} ended {describe_exit(code)}"
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return f"; {self.name} said: {lines[-1]}" if lines else ""


class StartupPacer:
    """Keeps a flight to a pace until the program has started all of its parts.

    The program answers steps long before that, and at full speed it would have flown before, say,
    its own log begins.
    """

    def __init__(self, program: RunningAutopilot) -> None:
        self._program = program
        self.finished = not program.startup_text
        self._began_s: float | None = None
        self._first_us = 0

    def wait_for_pace(self, t_us: int) -> None:
        """Wait until the wall clock is as far as the pace asks."""
        if self.finished:
            return
        if self._began_s is None:
            self._began_s, self._first_us = time.monotonic(), t_us
        ahead_s = (t_us - self._first_us) * 1e-6 / STARTUP_SPEED - (
            time.monotonic() - self._began_s
        )
        if ahead_s < MIN_WAIT_S:
            return
        time.sleep(ahead_s)
        told = self._program.startup_text in self._program.log.read_text(errors="replace")
        # Another version may use other words.
        self.finished = told or time.monotonic() - self._began_s > STARTUP_LIMIT_S


class RealTimePacer:
    """Keeps a flight to real time while an answer is awaited that runs on the wall clock.

    A flight stands before whatever else runs, the threads of its own operator too: on a busy
    machine PX4 would have disarmed itself before it heard of the take-off.
    """

    def __init__(self) -> None:
        self._pace: Pace | None = None

    def wait_for_pace(self, t_us: int, *, awaiting: bool) -> None:
        """Wait until the wall clock is as far as the flight since the question."""
        if not awaiting:
            self._pace = None
            return
        self._pace = self._pace or Pace(1.0)
        wait_s = self._pace.wait_s(t_us, time.monotonic())
        if wait_s >= MIN_WAIT_S:
            time.sleep(wait_s)


@contextlib.contextmanager
def terminate_on_exit(process: Process, within_s: float = SHUTDOWN_TIMEOUT_S) -> Iterator[Process]:
    """End a program in the end: kindly first, as it may want to write its log."""
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(within_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
