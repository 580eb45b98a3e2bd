"""A running autopilot: its process, its links, how it ended, and the pace of its flight."""

import contextlib
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.autopilots.hil_exchange import StepMessage, WaitableProcess
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.links.link import Link

MIN_WAIT_S = 0.02  # wall time by which the flight may be ahead of its pace
CAREFUL_SPEED = 4.0  # times real time; a faster flight delays the start (benchmarks/autopilots.md)
STARTUP_LIMIT_S = 60.0  # for versions that print another text
SHUTDOWN_TIMEOUT_S = 10.0  # for the process to close its logs

Process = subprocess.Popen[bytes]


@dataclass(frozen=True, slots=True)
class RunningAutopilot:
    """The autopilot's process and links, its console log, and the message that advances it a step.

    The first link is the HIL link, further ones are telemetry. `startup_text` appears on the
    console when its start is complete; the autopilot answers steps even earlier.
    """

    name: str
    process: WaitableProcess
    links: Sequence[Link]
    log: Path
    step_message: StepMessage
    startup_text: str = ""

    def exit_details(self) -> str:
        """Describe for an error message how it was killed, or its last console lines."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            if (code := self.process.wait(SHUTDOWN_TIMEOUT_S)) < 0:
                return f"; {self.name} ended {describe_exit(code)}"
        # Without repetitions: often the reason stands before the last line.
        lines = list(dict.fromkeys(self.log.read_text(errors="replace").strip().splitlines()))
        return f"; last output of {self.name}: {' | '.join(lines[-3:])}" if lines else ""


class Pacer:
    """Limits the speed of a flight until the autopilot has started, and where care is needed.

    PX4 answers steps long before its own log begins. It stores and reads a mission by the
    computer's clock, but waits for it by the vehicle's: at full speed some reads fail.
    """

    def __init__(self, autopilot: RunningAutopilot) -> None:
        self._autopilot = autopilot
        self.started = not autopilot.startup_text
        self._made_s = time.monotonic()
        self._began_s: float | None = None  # when the limit began to hold
        self._began_us = 0  # vehicle time then

    def wait_for_pace(self, t_us: int, *, careful: bool) -> None:
        """Sleep while the flight is ahead of its pace."""
        if self.started and not careful:
            self._began_s = None
            return
        now_s = time.monotonic()
        if self._began_s is None:
            self._began_s, self._began_us = now_s, t_us
        ahead_s = (t_us - self._began_us) * 1e-6 / CAREFUL_SPEED - (now_s - self._began_s)
        if ahead_s < MIN_WAIT_S:
            return
        time.sleep(ahead_s)
        if not self.started:
            printed = self._autopilot.log.read_text(errors="replace")
            # Another version may print another text.
            late = time.monotonic() - self._made_s > STARTUP_LIMIT_S
            self.started = late or self._autopilot.startup_text in printed


@contextlib.contextmanager
def terminate_on_exit(process: Process, within_s: float = SHUTDOWN_TIMEOUT_S) -> Iterator[Process]:
    """Terminate a process on exit, and kill it if it does not close its log in time."""
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(within_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
