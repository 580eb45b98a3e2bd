"""Frames received on a link, from all its streams."""

from mavproxy_fault.links.descriptors import wait_until_readable
from mavproxy_fault.links.link import Link
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser


class Inbox:
    """A link and the parsers of its streams."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self._parsers: dict[int, Parser] = {}

    def frames(self, wait_s: float = 0.0) -> list[Frame]:
        """Return the frames received since the last call, without junk.

        Waits up to `wait_s` seconds for data.
        """
        if wait_s > 0.0:
            wait_until_readable([self.link], wait_s)
        return [frame for chunk in self.link.read() for frame in self.parsed(*chunk)]

    def incomplete(self, stream: int) -> bool:
        """Whether a stream has delivered only part of a frame."""
        parser = self._parsers.get(stream)
        return parser is not None and parser.incomplete > 0

    def parsed(self, stream: int, data: bytes) -> list[Frame]:
        """Return the frames that a chunk completes; empty bytes end the stream."""
        # The stream has ended: its incomplete frame must not be joined with later data.
        if not data:
            self._parsers.pop(stream, None)
            return []
        parser = self._parsers.setdefault(stream, Parser())
        items = parser.push(data, datagram=self.link.datagrams)
        return [item for item in items if isinstance(item, Frame)]
