"""Interfaces of the core: links by their role, the fault engine, and the command responder."""

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:  # a proxy without faults starts faster without them
    from mavproxy_fault.fault_parts.fault import Outgoing
    from mavproxy_fault.wire.label import Label

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


class FaultEngine(Protocol):
    """The fault engine: frames in, frames with due times out, in link time.

    `wanted` are the ids of the messages it must see (None: all) and may change at any time;
    `release_us` is the link time at which `due` has frames to release. `t0_us` is the start of the
    schedule, `link_us` the link time of its newest input.
    """

    t0_us: int | None
    link_us: int

    @property
    def wanted(self) -> frozenset[int] | None: ...

    @property
    def release_us(self) -> int | None: ...

    def restart(self, t0_us: int) -> None:
        """End active faults and restart the schedule at `t0_us`."""

    def apply(
        self, frame: Frame, direction: str, t_us: int, route: Route = ANY, *, sealed: bool = False
    ) -> "list[Outgoing]":
        """Process a frame; a sealed (signed) one may be delayed or dropped but not changed."""

    def junk(
        self, data: bytes | Frame, direction: str, t_us: int, route: Route, *, sealed: bool = False
    ) -> "list[Outgoing]":
        """Process bytes that are not a frame, or a frame of an unknown message."""

    def due(self, t_us: int) -> "list[Outgoing]":
        """Return buffered frames due by `t_us`."""

    def drain_labels(self) -> "list[Label]":
        """Return the labels begun or ended since the last call."""

    def finish(self, t_us: int) -> "list[Label]":
        """End every fault and return the last labels."""


class CommandResponder(Protocol):
    """Responder for commands to the proxy itself; `wanted` are the messages it sees.

    Of those that are not `needed` one frame in each `SAMPLE_PERIOD_US` is enough.

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
