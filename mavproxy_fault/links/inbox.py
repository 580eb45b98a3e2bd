"""The frames that come in on a link, whichever of its streams they come on."""

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
        """What has come since the last call; bytes that are no frame are left out.

        Waits up to `wait_s` seconds for something to come.
        """
        if wait_s > 0.0:
            wait_until_readable([self.link], wait_s)
        return [frame for chunk in self.link.read() for frame in self.parsed(*chunk)]

    def incomplete(self, stream: int) -> bool:
        """Whether a stream owes the rest of a frame."""
        parser = self._parsers.get(stream)
        return parser is not None and parser.incomplete > 0

    def parsed(self, stream: int, data: bytes) -> list[Frame]:
        """The frames that a chunk completes."""
        # The stream has ended: its half frame must not be joined with what comes next.
        if not data:
            self._parsers.pop(stream, None)
            return []
        parser = self._parsers.setdefault(stream, Parser())
        items = parser.push(data, datagram=self.link.datagrams)
        return [item for item in items if isinstance(item, Frame)]
