"""Descriptors: what a link waits on, one over all its connections where the system has that.

Linux (epoll) and macOS (kqueue) have such a descriptor. Elsewhere, as on Windows, every connection
is waited on by itself, and room for pending writes is looked for a few times a second.
"""

import select
import selectors
import time
from collections.abc import Sequence

from mavproxy_fault.links.link import Link


class Descriptors:
    """The connections of one link."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()

    def filenos(self) -> list[int]:
        """What to `select` on; with a descriptor over all it is that one, always the same."""
        own = getattr(self._selector, "fileno", None)
        if own is not None:
            return [own()]
        return [key.fd for key in self._selector.get_map().values()]

    def add(self, fileno: int) -> None:
        """Wait for what comes on a descriptor."""
        self._selector.register(fileno, selectors.EVENT_READ)

    def watch_writable(self, fileno: int, *, wanted: bool) -> None:
        """Wait for room to write as well, or no longer."""
        room = selectors.EVENT_WRITE if wanted else 0
        self._selector.modify(fileno, selectors.EVENT_READ | room)

    def remove(self, fileno: int) -> None:
        """Forget a descriptor before it is closed."""
        self._selector.unregister(fileno)

    def ready(self) -> list[int]:
        """The descriptors that want service now."""
        # Windows refuses to wait for nothing.
        if not self._selector.get_map():
            return []
        return [key.fd for key, _ in self._selector.select(0)]

    def close(self) -> None:
        """Release what the system keeps for it."""
        self._selector.close()


def wait_until_readable(links: Sequence[Link], wait_s: float) -> None:
    """Wait until one of the links has something to read, `wait_s` seconds at most."""
    descriptors = [descriptor for link in links for descriptor in link.filenos()]
    if descriptors:
        select.select(descriptors, (), (), wait_s)
    else:  # Windows refuses to wait for nothing
        time.sleep(wait_s)
