"""Several links used as one: what one receives is read, and everything is sent on all."""

import contextlib
from collections.abc import Sequence

from mavproxy_fault.links.link import Chunk, Link, LinkCounters


class JoinedLinks:
    """A link over others; each of their streams has a number of its own."""

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = links
        self.name = ", ".join(link.name for link in links)
        self.datagrams = all(link.datagrams for link in links)
        self.counters = LinkCounters()

    @property
    def peer_count(self) -> int:
        """Number of peers that `write` reaches."""
        return sum(link.peer_count for link in self._links)

    def filenos(self) -> list[int]:
        """Return the descriptors of all links."""
        return [number for link in self._links for number in link.filenos()]

    def read(self) -> list[Chunk]:
        """Return received data as (stream, bytes)."""
        count = len(self._links)
        return [
            (stream * count + place, data)
            for place, link in enumerate(self._links)
            for stream, data in link.read()
        ]

    def write(self, data: bytes) -> None:
        """Send one chunk on every link."""
        for link in self._links:
            link.write(data)

    def close(self) -> None:
        """Close every link, also if one cannot be closed."""
        with contextlib.ExitStack() as closing:
            for link in self._links:
                closing.callback(link.close)
