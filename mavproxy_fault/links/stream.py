"""One open byte stream (a TCP connection or a serial device) with its bounded send queue, and links
that open one again."""

import contextlib
import math
import random
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from mavproxy_fault.links.descriptors import Descriptors
from mavproxy_fault.links.link import QUEUE_LIMIT, Chunk, LinkCounters

REOPEN_S = 0.5  # chosen: two attempts per second cost nothing
Pieces = tuple[int, int, float]  # bytes, how many more or fewer at random, seconds between two
Treatment = str | Pieces  # of a connection by a fault: how it is interrupted, or cut into pieces
READ_SIZE = 32_768  # bytes; junk read at once must still fit one datagram


class Stream:
    """A non-blocking descriptor with the two calls that read and write it.

    `empty_is_end` is true if an empty read means that the peer closed (TCP), false if it only
    means that no data are available (a serial device).
    """

    def __init__(
        self,
        fileno: int,
        calls: tuple[Callable[[int], bytes], Callable[[bytes], int]],
        descriptors: Descriptors,
        counters: LinkCounters,
        *,
        empty_is_end: bool,
    ) -> None:
        self.fileno = fileno
        self.open = True  # False while a TCP connection is being established
        self.pieces: Pieces | None = None  # what one call may send; None for all
        self._resume_s = 0.0  # end of the pause
        self._read, self._write = calls  # of a socket or a file: they differ on Windows
        self._descriptors = descriptors
        self._counters = counters
        self._empty_is_end = empty_is_end
        self._queue: deque[bytes] = deque()
        self._queued = 0
        self._awaits_room = False
        descriptors.add(fileno)

    def await_open(self) -> None:
        """Queue written data until the connection is established."""
        self.open = False
        self._await_room(wanted=True)

    @property
    def has_pending(self) -> bool:
        """Whether data are still to be sent, or sent in pieces only."""
        return bool(self._queue) or self.pieces is not None

    def write(self, data: bytes) -> None:
        """Send, or queue what the kernel does not accept; drop entire chunks beyond the limit."""
        # Entire chunks: half a frame would make the receiver lose synchronization.
        if self._queued + len(data) > QUEUE_LIMIT:
            self._counters.drops += 1
            return
        self._queue.append(data)
        self._queued += len(data)
        if self.open and len(self._queue) == 1:
            self.flush()

    def flush(self) -> float:
        """Send queued data until the kernel accepts no more, or a pause begins.

        Returns when the pause ends [s], infinity without one.
        """
        queue = self._queue
        while queue and time.monotonic() >= self._resume_s:
            data = queue[0]
            piece, pause_s = len(data), 0.0
            if self.pieces is not None:
                mean, most, pause_s = self.pieces
                piece = max(mean + random.randint(-most, most), 1)
            try:
                sent = self._write(data[:piece])
            except OSError:  # buffer full, or connection lost, which the next read detects
                break
            self._resume_s = time.monotonic() + pause_s if pause_s else 0.0
            self._queued -= sent
            self._counters.bytes_out += sent
            if sent < len(data):
                # Send the rest of this chunk first, or its frame would be split.
                queue[0] = data[sent:]
                break
            queue.popleft()
            self._counters.chunks_out += 1
        pauses = bool(queue) and time.monotonic() < self._resume_s
        self._await_room(wanted=bool(queue) and not pauses)
        return self._resume_s if pauses else math.inf

    def read(self, most: int = READ_SIZE) -> tuple[bytes, bool]:
        """Return received data, at most `most` bytes, and whether the stream is still open.

        Only one read per call, so that other links and due frames get their turn.
        """
        try:
            data = self._read(most)
        except BlockingIOError:
            return b"", True
        except OSError:
            return b"", False
        if not data:
            return b"", not self._empty_is_end
        self._counters.chunks_in += 1
        self._counters.bytes_in += len(data)
        return data, True

    def abandon(self) -> None:
        """Stop watching the descriptor before its owner closes it; count queued data as dropped."""
        self._counters.drops += len(self._queue)
        self._queue.clear()
        self._queued = 0
        # The kernel removes a closed descriptor by itself.
        with contextlib.suppress(OSError):
            self._descriptors.unregister(self.fileno)

    def _await_room(self, *, wanted: bool) -> None:
        # Saves a system call per frame.
        if wanted != self._awaits_room:
            self._awaits_room = wanted
            self._descriptors.watch_writable(self.fileno, wanted=wanted)


class ReopenedLink:
    """Base of links with one stream, which is opened again after it was lost.

    `_open` returns what it has opened (a socket, a device) and its stream, or raises OSError.
    """

    datagrams = False

    def __init__(self, name: str) -> None:
        self.name = name
        self.counters = LinkCounters()
        self._descriptors = Descriptors()
        self._peer: tuple[Any, Stream] | None = None
        self._number = 0  # of the stream: an incomplete frame is not continued in the next one
        self._retry_s = 0.0

    def _open(self) -> tuple[Any, Stream]:
        raise NotImplementedError

    def _is_open(self, _: Any, stream: Stream) -> bool:
        """Whether the stream's connection is established."""
        return stream.open

    def _read(self, _: Any, stream: Stream) -> tuple[bytes, bool]:
        return stream.read()

    @property
    def peer_count(self) -> int:
        """1 while it is open."""
        return int(self._peer is not None and self._peer[1].open)

    def lone_peer(self) -> tuple[int, int] | None:
        """Return descriptor and number of the stream if it is open and its queue is empty."""
        if self._peer is None or not self._peer[1].open or self._peer[1].has_pending:
            return None
        return self._peer[1].fileno, self._number

    def filenos(self) -> list[int]:
        """Return the descriptors of the present stream."""
        return self._descriptors.filenos()

    def read(self) -> list[Chunk]:
        """Open a lost stream, continue pending writes, and return received data."""
        if self._peer is None:
            if time.monotonic() >= self._retry_s:
                self._reopen()
            return []
        if not self._is_open(*self._peer):
            return []
        self._peer[1].flush()
        data, is_open = self._read(*self._peer)
        chunks = [(self._number, data)] if data else []
        if not is_open:
            self._lose()
            chunks.append((self._number, b""))
            self._number += 1
        return chunks

    def flush(self) -> float:
        """Send what a pause has kept; return when the next one ends [s]."""
        return math.inf if self._peer is None else self._peer[1].flush()

    def _reopen(self) -> None:
        self._retry_s = time.monotonic() + REOPEN_S
        with contextlib.suppress(OSError):
            self._peer = self._open()

    def _lose(self) -> None:
        self.counters.errors += 1
        self._abandon()

    def _abandon(self) -> None:
        if self._peer is not None:
            self._peer[1].abandon()
            self._peer[0].close()
            self._peer = None

    def write(self, data: bytes) -> None:
        """Send one chunk; it is dropped while there is no stream, as it would be stale later."""
        if self._peer is None:
            self.counters.drops += 1
        else:
            self._peer[1].write(data)

    def close(self) -> None:
        """Close the stream."""
        self._abandon()
        self._descriptors.close()
