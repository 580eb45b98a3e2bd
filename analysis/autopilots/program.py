"""An autopilot's program in flight: its process, where it is heard, and how it ended."""

import contextlib
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.autopilots.hil_exchange import Ending, StepMessage
from mavproxy_fault.ardupilot.child_process import ending
from mavproxy_fault.links.link import Link

END_S = 10.0  # for a program to close its logs

Process = subprocess.Popen[bytes]


@dataclass(frozen=True, slots=True)
class Program:
    """What flies, the log of what it says on its console, and the message that steps it.

    The first link is the HIL link, further ones are its telemetry.
    """

    name: str
    process: Ending
    links: Sequence[Link]
    log: Path
    step: StepMessage

    def last_words(self) -> str:
        """How it ended where it was killed, else what it said last; for a message."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            if (code := self.process.wait(END_S)) < 0:
                return f"; {self.name} ended {ending(code)}"
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return f"; {self.name} said: {lines[-1]}" if lines else ""


@contextlib.contextmanager
def ended(process: Process, within_s: float = END_S) -> Iterator[Process]:
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
