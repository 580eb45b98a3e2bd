"""Receive thread: buffers a link while the monitor compiles kernels or falls behind.

The operating system's socket buffer holds a few seconds of HIL traffic; compiling the numerical
kernels for the first time takes longer.
"""

import queue
import threading
from collections.abc import Iterator

from mavproxy_fault.links.descriptors import wait_until_readable
from mavproxy_fault.links.link import Link

MAX_CHUNKS = 500_000  # about ten minutes of HIL traffic
CHUNKS_AT_ONCE = 1000
# Chosen: long enough not to spin, short enough to end promptly after Ctrl-C.
POLL_TIMEOUT_S = 0.1


class LinkBuffer:
    """Chunks of a link in order; `drops` counts those discarded because the buffer was full."""

    def __init__(self, link: Link) -> None:
        self.drops = 0
        self._link = link
        self._chunks: queue.Queue[bytes] = queue.Queue(MAX_CHUNKS)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def __enter__(self) -> "LinkBuffer":
        self._thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        # Set the flag first: the thread reads the link until it sees it; only then may the link
        # close.
        self._over.set()
        self._thread.join()
        self._link.close()

    def drain(self) -> Iterator[bytes]:
        """Chunks received so far, at most `CHUNKS_AT_ONCE`; waits `POLL_TIMEOUT_S` for the
        first."""
        try:
            yield self._chunks.get(timeout=POLL_TIMEOUT_S)
            for _ in range(CHUNKS_AT_ONCE - 1):
                yield self._chunks.get_nowait()
        except queue.Empty:
            return

    def _receive(self) -> None:
        while not self._over.is_set():
            # With a timeout: the thread must check the flag on a silent link too.
            wait_until_readable([self._link], POLL_TIMEOUT_S)
            for _, data in self._link.read():
                try:
                    self._chunks.put_nowait(data)
                except queue.Full:
                    # Drop instead of waiting: waiting would overflow the socket buffer.
                    self.drops += 1
