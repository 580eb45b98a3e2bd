"""Descriptors that a link waits on: a single one for all its connections where possible.

Linux (epoll) and macOS (kqueue) have such a descriptor. On other systems, such as Windows, each
connection has its own, and pending writes are retried a few times per second.
"""

import select
import selectors
import time
from collections.abc import Sequence

from mavproxy_fault.links.link import Link


class Descriptors(selectors.DefaultSelector):
    """The selector of all connections of one link."""

    def filenos(self) -> list[int]:
        """Return the descriptors for `select`; a common descriptor never changes."""
        own = getattr(self, "fileno", None)
        if own is not None:
            return [own()]
        return [key.fd for key in self.get_map().values()]

    def add(self, fileno: int) -> None:
        """Watch a descriptor for received data."""
        self.register(fileno, selectors.EVENT_READ)

    def watch_writable(self, fileno: int, *, wanted: bool) -> None:
        """Start or stop watching a descriptor for space to write."""
        room = selectors.EVENT_WRITE if wanted else 0
        self.modify(fileno, selectors.EVENT_READ | room)

    def ready(self) -> list[int]:
        """Return the descriptors that are ready now."""
        # Windows cannot wait on an empty set.
        if not self.get_map():
            return []
        return [key.fd for key, _ in self.select(0)]


def wait_until_readable(links: Sequence[Link], wait_s: float) -> None:
    """Wait until one of the links is readable, at most `wait_s` seconds."""
    descriptors = [descriptor for link in links for descriptor in link.filenos()]
    if descriptors:
        select.select(descriptors, (), (), wait_s)
    else:  # Windows cannot wait on an empty set
        time.sleep(wait_s)
