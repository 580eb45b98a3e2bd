"""Streams that arrive in small pieces."""

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from mavproxy_fault.fault_parts.rules import Effect, Numbers, RuleLinkFault, link_rule


@link_rule
def keep_number(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Count the frame, which the link cuts: its sequence number comes round to itself."""
    return 256


class Slice(RuleLinkFault, frozen=True, kw_only=True):
    """Send what TCP endpoints get in pieces of `value` bytes, each by a system call of its own.

    A receiver then reads parts of frames, as toxiproxy's `slicer` makes it. Frames stay whole in
    the recording, and on UDP.
    """

    name: ClassVar[str] = "slice"
    example: ClassVar[dict[str, Any]] = {"value": 8}

    takes_bytes: ClassVar[bool] = False
    takes_unknown: ClassVar[bool] = True
    takes_sealed: ClassVar[bool] = False
    rule = staticmethod(keep_number)
    effect: ClassVar[Effect] = "renumber"
    certain: ClassVar[bool] = True

    value: Annotated[int, Meta(ge=1)] = 8

    @property
    def connection(self) -> int:
        """The size of a piece, for the links."""
        return self.value
