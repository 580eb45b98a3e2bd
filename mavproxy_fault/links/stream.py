"""One open byte stream (a TCP connection or a serial device) with its bounded send queue."""

import contextlib
from collections import deque
from collections.abc import Callable

from mavproxy_fault.links.descriptors import Descriptors
from mavproxy_fault.links.link import QUEUE_LIMIT, LinkCounters

READ_SIZE = 32_768  # what is no frame must still fit one datagram


class Stream:
    """A non-blocking descriptor that its link watches, read and written by two calls.

    `empty_is_end` tells whether reading nothing means that the peer closed (TCP) or only that
    nothing waits (a serial device).
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
        self.open = True  # False while a TCP connection is still being made
        self._read, self._write = calls  # of a socket or a file: Windows tells them apart
        self._descriptors = descriptors
        self._counters = counters
        self._empty_is_end = empty_is_end
        self._queue: deque[tuple[bytes, int]] = deque()  # and of how many chunks they are
        self._queued = 0
        self._awaits_room = False
        descriptors.add(fileno)

    def await_open(self) -> None:
        """Hold what is written until the connection stands."""
        self.open = False
        self._await_room(wanted=True)

    @property
    def has_pending(self) -> bool:
        """Whether something is still to be sent."""
        return bool(self._queue)

    def write(self, data: bytes, chunks: int = 1) -> None:
        """Send, or queue what the kernel does not take; drop whole chunks beyond the limit."""
        # Whole chunks: half a frame would make the receiver lose its place.
        if self._queued + len(data) > QUEUE_LIMIT:
            self._counters.drops += chunks
            return
        self._queue.append((data, chunks))
        self._queued += len(data)
        if self.open and len(self._queue) == 1:
            self.flush()

    def flush(self) -> None:
        """Send what is queued until the kernel takes no more; a part sent is continued later."""
        queue = self._queue
        while queue:
            data, chunks = queue[0]
            try:
                sent = self._write(data)
            except OSError:  # full, or lost: the next read notices the latter
                break
            self._queued -= sent
            self._counters.bytes_out += sent
            if sent < len(data):
                # The rest of this chunk goes first, or its frame would be torn.
                queue[0] = data[sent:], chunks
                break
            queue.popleft()
            self._counters.chunks_out += chunks
        self._await_room(wanted=bool(queue))

    def read(self, most: int = READ_SIZE) -> tuple[bytes, bool]:
        """What has come, so many bytes at most, and whether the stream still stands.

        One read, however much waits: other links and due frames get their turn in between.
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
        """Stop watching the descriptor before its owner closes it; count what is lost."""
        self._counters.drops += sum(chunks for _, chunks in self._queue)
        self._queue.clear()
        self._queued = 0
        # The kernel forgets a closed descriptor by itself.
        with contextlib.suppress(OSError):
            self._descriptors.remove(self.fileno)

    def _await_room(self, *, wanted: bool) -> None:
        # A system call saved for each frame.
        if wanted != self._awaits_room:
            self._awaits_room = wanted
            self._descriptors.watch_writable(self.fileno, wanted=wanted)
