"""Streams that arrive in small pieces."""

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import Generator, LinkFault, Outgoing
from mavproxy_fault.wire.frame import Frame


class Slice(LinkFault, frozen=True, kw_only=True):
    """Send what TCP endpoints get in pieces of `value` bytes, each by a system call of its own.

    A receiver then reads parts of frames, as toxiproxy's `slicer` makes it. Frames stay whole in
    the recording, and on UDP.
    """

    name: ClassVar[str] = "slice"
    example: ClassVar[dict[str, Any]] = {"value": 8}

    value: Annotated[int, Meta(ge=1)] = 8

    @property
    def connection(self) -> int:
        """The size of a piece, for the links."""
        return self.value

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: Generator
    ) -> tuple[list[Outgoing], Any]:
        """Count the frame, which the link cuts: a copy is another frame than the one that came."""
        if isinstance(frame, Frame) and not frame.signed:
            frame = Frame(frame.raw, frame.layout)
        return [Outgoing(t_us, frame)], None
