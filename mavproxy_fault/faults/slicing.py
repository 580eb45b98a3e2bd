"""Streams that arrive in small pieces."""

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.fault_parts.rules import Effect, Numbers, RuleLinkFault, link_rule


@link_rule
def keep_number(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Count the frame, which the link cuts: its sequence number comes round to itself."""
    return 256


class Slice(RuleLinkFault, frozen=True, kw_only=True):
    """Send what TCP endpoints get in pieces of `value` bytes, each by a system call of its own.

    Sizes vary at random by up to `variation_bytes`, and `pause_s` pass between two pieces. So a
    receiver reads parts of frames, as toxiproxy's `slicer` makes it. Frames stay whole in the
    recording, and on UDP; what a pause holds up beyond 1 MiB is dropped, as for a slow reader.
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
    variation_bytes: Annotated[int, Meta(ge=0)] = 0
    pause_s: Seconds = 0.0

    @property
    def connection(self) -> tuple[int, int, float]:
        """The pieces, for the links."""
        return self.value, self.variation_bytes, self.pause_s
