"""A log on standard error that drops lines instead of blocking.

An unread pipe or a stopped terminal (Ctrl-S) would block the proxy, and a peer that reconnects
repeatedly can make it write.
"""

import logging
import select
import sys

LONGEST = 4000  # bytes of a line: a pipe that is ready for writing takes 4,096 (PIPE_BUF)


class LossyHandler(logging.StreamHandler):  # type: ignore[type-arg]  # a plain class at run time
    """Replaces `logging.lastResort`, which blocks."""

    def __init__(self) -> None:
        super().__init__(sys.stderr)
        self.setLevel(logging.WARNING)
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, or count it as lost if writing would block."""
        if not self._has_room():
            self._lost += 1
            return
        if self._lost:
            super().emit(logging.makeLogRecord({"msg": f"({self._lost} lines are missing here)"}))
            self._lost = 0
        super().emit(record)

    def format(self, record: logging.LogRecord) -> str:
        """Format the line; a long traceback keeps its end."""
        return super().format(record).encode(errors="replace")[-LONGEST:].decode(errors="ignore")

    def _has_room(self) -> bool:
        try:
            return bool(select.select((), (self.stream,), (), 0)[1])
        except (OSError, ValueError):  # closed, not a file, or Windows
            return True
