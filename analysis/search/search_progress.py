"""Progress lines of a search on standard error."""

import sys
import time

LINE_S = 10.0  # between lines in a file; a terminal shows one line that is updated


class SearchProgress:
    """Prints the number of tests and the worst error, then the steps after the search."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._last_s = time.monotonic()
        self._open = False  # an updated line is not finished yet

    def __call__(self, tests: int, worst: float, budget: int) -> None:
        """Show the state after some tests."""
        line = f"{tests} of {budget} tests, worst {worst:.4g} {self._unit}".rstrip()
        if sys.stderr.isatty():
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
            self._open = True
        elif time.monotonic() - self._last_s >= LINE_S or tests == budget:
            self._last_s = time.monotonic()
            print(line, file=sys.stderr, flush=True)

    def print_line(self, text: str) -> None:
        """Print a separate line."""
        print(f"\n{text}" if self._open else text, file=sys.stderr, flush=True)
        self._open = False
