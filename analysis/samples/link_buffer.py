"""A link drained by a thread, so that nothing is lost while the monitor compiles or falls behind.

The kernel's buffer holds a few seconds of HIL traffic; compiling the kernels for the first time
takes longer.
"""

import queue
import threading
from collections.abc import Iterator
from types import TracebackType

from mavproxy_fault.links.descriptors import wait_until_readable
from mavproxy_fault.links.link import Link

MAX_CHUNKS = 500_000  # about ten minutes of HIL traffic
CHUNKS_AT_ONCE = 1000
# Long enough not to spin, short enough to end soon after Ctrl-C.
POLL_TIMEOUT_S = 0.1


class LinkBuffer:
    """Chunks of a link in order; `drops` counts what no longer found room."""

    def __init__(self, link: Link) -> None:
        self.drops = 0
        self._link = link
        self._chunks: queue.Queue[bytes] = queue.Queue(MAX_CHUNKS)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def __enter__(self) -> "LinkBuffer":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # The flag first: the thread reads the link until it has seen it, and only then may that
        # close.
        self._over.set()
        self._thread.join()
        self._link.close()

    def drain(self) -> Iterator[bytes]:
        """What has come by now, `CHUNKS_AT_ONCE` at most; waits a little for the first of it."""
        try:
            yield self._chunks.get(timeout=POLL_TIMEOUT_S)
            for _ in range(CHUNKS_AT_ONCE - 1):
                yield self._chunks.get_nowait()
        except queue.Empty:
            return

    def _receive(self) -> None:
        while not self._over.is_set():
            # With a time limit: the thread must look at the flag also on a silent link.
            wait_until_readable([self._link], POLL_TIMEOUT_S)
            for _, data in self._link.read():
                try:
                    self._chunks.put_nowait(data)
                except queue.Full:
                    # Counted, never waited for: waiting would lose the newest bytes in the kernel
                    # instead.
                    self.drops += 1
