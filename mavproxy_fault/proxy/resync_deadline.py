"""Deadline for the rest of an incomplete frame on a stream.

A false start byte (foreign bytes, a broken frame) announces up to 280 bytes. Until these arrive or
are abandoned, everything behind it waits, including complete frames; on a slow link for many
seconds. So each possible frame has a deadline, counted from its first byte.
"""

from collections import deque

from mavproxy_fault.wire.parser import Parser

MAX_GAP_US = 500_000  # without a byte; chosen: telemetry radios pause in the middle of a frame
MAX_FRAME_US = 1_000_000  # the time of 280 bytes at 2,800 baud
MAX_BLOCKING_US = 200_000  # with a verified frame behind it the start is almost surely false


class ResyncDeadline:
    """Arrival times of the bytes of one stream's incomplete frame."""

    def __init__(self) -> None:
        self._chunks: deque[tuple[int, int]] = deque()  # number of bytes, arrival time
        self._bytes = 0

    def note_arrival(self, count: int, now_us: int) -> None:
        """Record the arrival of bytes."""
        self._chunks.append((count, now_us))
        self._bytes += count

    def due_us(self, parser: Parser) -> int | None:
        """Return when the parser must abandon its incomplete frame; None without one."""
        # Only the newest bytes are incomplete: earlier chunks have been parsed.
        while self._chunks and self._bytes - self._chunks[0][0] >= parser.incomplete:
            self._bytes -= self._chunks.popleft()[0]
        if not self._chunks:
            return None
        first_us, last_us = self._chunks[0][1], self._chunks[-1][1]
        if parser.contains_frame:
            return first_us + MAX_BLOCKING_US
        return min(first_us + MAX_FRAME_US, last_us + MAX_GAP_US)
