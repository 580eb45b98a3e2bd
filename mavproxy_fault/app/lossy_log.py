"""A log on standard error that leaves lines out rather than wait for who reads them.

A pipe that nobody reads, or a terminal that was stopped (Ctrl-S), would hold the writer up, and a
stranger who connects again and again makes the proxy write.
"""

import logging
import select
import sys

LONGEST = 4000  # bytes of a line: a pipe that takes anything at once takes 4,096


class LossyHandler(logging.StreamHandler):  # type: ignore[type-arg]  # a plain class at run time
    """Stands in for `logging.lastResort`, which waits."""

    def __init__(self) -> None:
        super().__init__(sys.stderr)
        self.setLevel(logging.WARNING)
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, or count it where it would have to wait."""
        if not self._has_room():
            self._lost += 1
            return
        if self._lost:
            super().emit(logging.makeLogRecord({"msg": f"({self._lost} lines are missing here)"}))
            self._lost = 0
        super().emit(record)

    def format(self, record: logging.LogRecord) -> str:
        """The line; of a long traceback its end."""
        return super().format(record).encode(errors="replace")[-LONGEST:].decode(errors="ignore")

    def _has_room(self) -> bool:
        try:
            return bool(select.select((), (self.stream,), (), 0)[1])
        except (OSError, ValueError):  # closed, no file at all, or Windows
            return True
