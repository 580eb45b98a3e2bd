"""What the core is joined to: links by their role, the fault engine, and the control path."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:  # both cost start-up time that a proxy without faults need not pay
    from mavproxy_fault.fault_parts.fault import Outgoing
    from mavproxy_fault.wire.label import Label

Direction = Literal["to-vehicle", "from-vehicle"]


class Send(NamedTuple):
    """Bytes for one link, to leave at `due_us` of the wall clock."""

    link: int
    data: bytes
    due_us: int


@dataclass(frozen=True, slots=True)
class LinkRole:
    """A link as the core sees it: `direction` is the way of what comes in on it."""

    name: str
    direction: Direction
    datagrams: bool = True


class FaultEngine(Protocol):
    """The faults: frames in, timed frames out, on the vehicle's time.

    `wanted` are the ids of the messages it must see (None: all) and may change at any time;
    `release_us` is the vehicle time at which `due` has something.
    """

    @property
    def wanted(self) -> frozenset[int] | None: ...

    @property
    def release_us(self) -> int | None: ...

    def restart(self, t0_us: int) -> None:
        """End what acts and count the schedule's times from `t0_us`."""

    def apply(
        self, frame: Frame, direction: Direction, t_us: int, *, sealed: bool = False
    ) -> "list[Outgoing]":
        """What leaves for one frame; a sealed one may be delayed or dropped but not changed."""

    def junk(self, data: bytes, direction: Direction, t_us: int) -> "list[Outgoing]":
        """What leaves for bytes that are no frame."""

    def due(self, t_us: int) -> "list[Outgoing]":
        """What was held until now."""

    def drain_labels(self) -> "list[Label]":
        """Labels begun or ended since the last call."""

    def finish(self, t_us: int) -> "list[Label]":
        """End every label."""


class CommandResponder(Protocol):
    """Whatever answers commands for the proxy itself; `wanted` are the messages it must see."""

    @property
    def wanted(self) -> frozenset[int]: ...

    def consume(self, frame: Frame, t_us: int) -> list[Frame] | None:
        """Replies for the link the frame came on if it was for the proxy, else None."""

    def sent(self, raw: bytes, t_us: int) -> None:
        """Look at what leaves, at the vehicle's time."""
