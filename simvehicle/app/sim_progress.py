"""Progress messages of a running simulator, on standard error."""

import os
import sys
from typing import TextIO

TERMINAL_PERIOD_S = 0.5  # between updates of the line that is overwritten
FILE_PERIOD_S = 10.0  # between lines in a log file


class Progress:
    """Reports simulated time and speed periodically; wall time is passed in as `now_s`."""

    def __init__(self, now_s: float, out: TextIO | None = None) -> None:
        self._out = out or sys.stderr
        self._terminal = self._out.isatty()
        # A file keeps each line, so it gets fewer.
        self._period_s = TERMINAL_PERIOD_S if self._terminal else FILE_PERIOD_S
        self._start_s = self._last_s = now_s
        self._last_us = 0
        self._open = False  # whether the current line may be overwritten

    def say(self, text: str) -> None:
        """Write a line of text."""
        self._end_line()
        self._out.write(text + "\n")
        self._out.flush()

    def step(self, t_us: int, now_s: float, note: str = "") -> None:
        """Write the progress if it is due; called each step."""
        span_s = now_s - self._last_s
        if span_s < self._period_s or (self._terminal and not self._in_foreground()):
            return
        speed = (t_us - self._last_us) * 1e-6 / span_s
        line = f"{t_us * 1e-6:8.1f} s simulated, {speed:.1f} times real time{note}"
        # Return to the start of the line and clear it.
        self._out.write("\r\x1b[K" + line if self._terminal else line + "\n")
        self._out.flush()
        self._open = self._terminal
        self._last_s, self._last_us = now_s, t_us

    def end(self, t_us: int, now_s: float) -> None:
        """Write a summary of the flight."""
        # Never zero: a flight may end within one tick of the clock.
        wall_s = max(now_s - self._start_s, 1e-9)
        speed = t_us * 1e-6 / wall_s
        self.say(f"{t_us * 1e-6:.1f} s simulated in {wall_s:.1f} s, {speed:.1f} times real time")

    def _in_foreground(self) -> bool:
        """Whether the terminal's user waits for this process; else he types over its line."""
        try:
            return os.tcgetpgrp(self._out.fileno()) == os.getpgrp()
        except (AttributeError, OSError):  # Windows; a terminal that controls another session
            return True

    def _end_line(self) -> None:
        if self._open:
            self._out.write("\n")
            self._open = False
