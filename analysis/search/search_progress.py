"""What a search tells the person in front of it, on standard error."""

import sys
import time

LINE_S = 10.0  # between lines in a file; on a terminal one line is written over


class SearchProgress:
    """How many tests were made and how bad the worst is; then what is done with it."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._last_s = time.monotonic()
        self._open = False  # a line waits to be written over

    def __call__(self, tests: int, worst: float, budget: int) -> None:
        """Called whenever tests were made."""
        line = f"{tests} of {budget} tests, worst {worst:.4g} {self._unit}".rstrip()
        if sys.stderr.isatty():
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
            self._open = True
        elif time.monotonic() - self._last_s >= LINE_S or tests == budget:
            self._last_s = time.monotonic()
            print(line, file=sys.stderr, flush=True)

    def print_line(self, text: str) -> None:
        """A line of its own."""
        print(f"\n{text}" if self._open else text, file=sys.stderr, flush=True)
        self._open = False
