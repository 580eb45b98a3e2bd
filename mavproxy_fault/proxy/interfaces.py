"""Interfaces of the core: links by their role, and the command responder."""

from array import array
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from mavproxy_fault.wire.frame import Frame

NEVER_US = 1 << 62  # later than any timestamp (below `sender_rules.MAX_STAMP_US`)

Direction = Literal["to-vehicle", "from-vehicle"]


class Send(NamedTuple):
    """Bytes to send on one link at wall time `due_us`."""

    link: int
    data: bytes
    due_us: int


@dataclass(frozen=True, slots=True)
class LinkRole:
    """A link as the core sees it; `direction` is that of data received on it."""

    name: str
    direction: Direction
    datagrams: bool = True


class Route(NamedTuple):
    """The links that a frame comes from and goes to, bit masks, and its link time.

    All links unless they are known, and the vehicle time if there is no other.
    """

    come: int = -1
    go: int = -1
    link_us: int | None = None


ANY = Route()


class CommandResponder(Protocol):
    """Responder for commands to the proxy itself; `wanted` are the messages it sees.

    Of those that are not `needed` machine code only keeps samples.

    `senders` is the core's state of the senders, set by `Core.attach`.
    """

    senders: "array[int]"

    @property
    def wanted(self) -> frozenset[int]: ...

    @property
    def needed(self) -> frozenset[int]: ...

    def consume(
        self, frame: Frame, direction: Direction, t_us: int, *, sealed: bool = False
    ) -> list[Frame] | None:
        """Return replies for the frame's link if it was for the proxy, else None."""

    def sent(self, raw: bytes, t_us: int) -> None:
        """Observe a sent frame, at its vehicle time."""

    def note_samples(self, records: bytes) -> None:
        """Take the samples that machine code has kept."""
