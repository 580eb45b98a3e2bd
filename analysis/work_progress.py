"""Progress of long work on standard error: a bar on a terminal, a line per tenth elsewhere."""

import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

REDRAW_S = 0.2  # drawing takes longer than a step of a simulation


class WorkProgress:
    """Shows how much of `total` is done; of seconds of flight also how fast they pass."""

    def __init__(self, doing: str, total: float, unit: str = "s") -> None:
        self._doing, self._total, self._unit = doing, total, unit
        self._start_s = time.monotonic()
        self._next_s, self._tenth = 0.0, 0
        self._console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TaskProgressColumn(),
        )
        status = TextColumn("{task.fields[status]}", markup=False)
        off = not self._console.is_terminal
        self._bar = Progress(
            *columns, TimeRemainingColumn(), status, console=self._console, disable=off
        )
        self._task = self._bar.add_task(doing, total=total, status="")

    def __enter__(self) -> "WorkProgress":
        self._bar.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._bar.stop()

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        self._console.print(text)

    def show(self, done: float, beside: str = "", total: float | None = None) -> None:
        """Show the progress and the text `beside` it; `total` replaces the first one."""
        self._total = total or self._total
        now_s = time.monotonic() - self._start_s
        if now_s < self._next_s and done < self._total:
            return
        self._next_s = now_s + REDRAW_S
        if self._unit == "s":
            status = f"{done:6.1f} s  x{done / max(now_s, REDRAW_S):.1f}  {beside}"
        else:
            status = f"{done:g} of {self._total:g} {self._unit}  {beside}"
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done, total=self._total, status=status)
            return
        # A line per tenth does not flood the log of a CI.
        tenth = int(10 * done / self._total) if self._total else 0
        if tenth > self._tenth:
            self._tenth = tenth
            self.say(f"{self._doing} {status}".rstrip())
