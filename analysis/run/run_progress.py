"""Progress on the terminal: simulated or processed time, speed, and active faults."""

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

REDRAW_S = 0.2


class RunProgress:
    """A bar on a terminal; in a file or a pipe, a line per tenth of the total."""

    def __init__(self, total_s: float, doing: str = "flying") -> None:
        self._total_s, self._doing = total_s, doing
        self._start_s = time.monotonic()
        self._next_s = 0.0
        self._tenth = 0
        self._console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[status]}", markup=False),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task(doing, total=total_s, status="")

    def __enter__(self) -> "RunProgress":
        self._bar.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._bar.stop()

    @property
    def elapsed_s(self) -> float:
        """Wall time since the start."""
        return time.monotonic() - self._start_s

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def show(self, sim_s: float, beside: str = "") -> None:
        """Draw the progress and the text `beside` it, a few times per second at most."""
        now_s = self.elapsed_s
        # Drawing takes longer than a simulation step.
        if now_s < self._next_s:
            return
        self._next_s = now_s + REDRAW_S
        speed = sim_s / now_s if now_s > 0 else 0.0
        status = f"{sim_s:6.1f} s  x{speed:.1f}  {beside}"
        if self._console.is_terminal:
            self._bar.update(self._task, completed=sim_s, status=status)
            return
        # A line per tenth does not flood the log of a CI.
        tenth = int(10 * sim_s / self._total_s) if self._total_s else 0
        if tenth > self._tenth:
            self._tenth = tenth
            print(f"{self._doing} {status}", file=sys.stderr, flush=True)
