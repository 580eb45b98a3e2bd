"""How long a stream is waited for that owes the rest of a frame.

A start byte that is none (foreign bytes, a broken frame) announces up to 280 bytes. Until they have
come, or are given up, everything behind it waits, whole frames too; on a link with few messages
that is many seconds. So each beginning has a time of its own, counted from its first byte.
"""

from collections import deque

from mavproxy_fault.wire.parser import Parser

MAX_GAP_US = 500_000  # without a byte; radio links pause in the middle of a frame
MAX_FRAME_US = 1_000_000  # 280 bytes at 2,800 baud
MAX_BLOCKING_US = 200_000  # if a verified frame stands behind, the beginning is hardly one


class ResyncDeadline:
    """When the bytes of one stream came, as far as they belong to an incomplete frame."""

    def __init__(self) -> None:
        self._chunks: deque[tuple[int, int]] = deque()  # bytes, and when they came
        self._bytes = 0

    def note_arrival(self, count: int, now_us: int) -> None:
        """Note when so many bytes came."""
        self._chunks.append((count, now_us))
        self._bytes += count

    def due_us(self, parser: Parser) -> int | None:
        """When the parser is to give up what it waits for; None if it waits for nothing."""
        # Only the newest bytes still wait: those of earlier chunks have left.
        while self._chunks and self._bytes - self._chunks[0][0] >= parser.incomplete:
            self._bytes -= self._chunks.popleft()[0]
        if not self._chunks:
            return None
        first_us, last_us = self._chunks[0][1], self._chunks[-1][1]
        if parser.contains_frame:
            return first_us + MAX_BLOCKING_US
        return min(first_us + MAX_FRAME_US, last_us + MAX_GAP_US)
