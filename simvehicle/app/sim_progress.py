"""What a running simulator tells the person in front of it, on standard error."""

import sys
from typing import TextIO

TERMINAL_PERIOD_S = 0.5  # a line that is written over
FILE_PERIOD_S = 10.0  # lines that stay


class Progress:
    """Simulated time and speed every now and then; wall time comes in as `now_s`."""

    def __init__(self, now_s: float, out: TextIO | None = None) -> None:
        self._out = out or sys.stderr
        self._terminal = self._out.isatty()
        # A file keeps each line, so it gets fewer.
        self._period_s = TERMINAL_PERIOD_S if self._terminal else FILE_PERIOD_S
        self._start_s = self._last_s = now_s
        self._last_us = 0
        self._open = False  # whether a line waits to be written over

    def say(self, text: str) -> None:
        """A line of its own."""
        self._end_line()
        self._out.write(text + "\n")
        self._out.flush()

    def step(self, t_us: int, now_s: float, note: str = "") -> None:
        """Called each step; writes when it is time to."""
        span_s = now_s - self._last_s
        if span_s < self._period_s:
            return
        speed = (t_us - self._last_us) * 1e-6 / span_s
        line = f"{t_us * 1e-6:8.1f} s simulated, {speed:.1f} times real time{note}"
        # Back to the start of the line, and clear to its end.
        self._out.write("\r\x1b[K" + line if self._terminal else line + "\n")
        self._out.flush()
        self._open = self._terminal
        self._last_s, self._last_us = now_s, t_us

    def end(self, t_us: int, now_s: float) -> None:
        """The whole flight in one line."""
        # Never zero: a flight may be over within the clock's step.
        wall_s = max(now_s - self._start_s, 1e-9)
        speed = t_us * 1e-6 / wall_s
        self.say(f"{t_us * 1e-6:.1f} s simulated in {wall_s:.1f} s, {speed:.1f} times real time")

    def _end_line(self) -> None:
        if self._open:
            self._out.write("\n")
            self._open = False
