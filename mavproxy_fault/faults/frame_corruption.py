"""Corrupted frames: wrong bytes, truncation, gaps in the sequence number."""

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import Generator, LinkFault, Outgoing
from mavproxy_fault.fault_parts.rules import Effect, Numbers, RuleLinkFault, link_rule
from mavproxy_fault.faults.loss import Share
from mavproxy_fault.faults.timing import choose_share
from mavproxy_fault.wire.frame import Frame


class Corrupt(LinkFault, frozen=True, kw_only=True):
    """Replace `count` random payload bytes in a fraction `value` of the frames.

    The CRC is `left` unchanged, so that receivers reject the frame, or `redone` to match.
    """

    name: ClassVar[str] = "corrupt"
    example: ClassVar[dict[str, Any]] = {"crc": "redone", "target": "HIL_SENSOR"}

    value: Share = 1.0
    count: Annotated[int, Meta(ge=1)] = 1
    crc: Literal["left", "redone"] = "left"

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: Generator
    ) -> tuple[list[Outgoing], Any]:
        """Replace some bytes, each by a different value."""
        # No random draw if every frame is affected.
        if self.value < 1.0 and rng.random() >= self.value:
            return [Outgoing(t_us, frame)], None
        if isinstance(frame, bytes):
            return [Outgoing(t_us, self._mixed(frame, rng))], None
        payload = self._mixed(frame.payload, rng)
        if self.crc == "redone":
            return [Outgoing(t_us, frame.with_payload(payload))], None
        # Header and checksum stay, so that receivers reject the frame.
        end = frame.payload_at + frame.length
        raw = frame.raw[: frame.payload_at] + payload + frame.raw[end:]
        return [Outgoing(t_us, raw)], None

    def _mixed(self, data: bytes, rng: Generator) -> bytes:
        mixed = bytearray(data)
        places = rng.choice(len(mixed), min(self.count, len(mixed)), replace=False)
        # From 1, since XOR with 0 would change nothing.
        for place, change in zip(places, rng.integers(1, 256, len(places)), strict=True):
            mixed[place] ^= int(change)
        return bytes(mixed)


class Truncate(RuleLinkFault, frozen=True, kw_only=True):
    """Cut the last `count` bytes off a fraction `value` of the frames."""

    name: ClassVar[str] = "truncate"
    example: ClassVar[dict[str, Any]] = {}
    rule = staticmethod(choose_share)
    parameters: ClassVar[tuple[str, ...]] = ("value", "count")
    effect: ClassVar[Effect] = "cut"

    value: Share = 1.0
    count: Annotated[int, Meta(ge=1)] = 4


@link_rule
def skip_numbers(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Advance the offset of the sequence number, `m[1]`, at a share of the frames."""
    if u < p[0]:
        m[1] = (m[1] + p[1]) % 256.0  # it wraps like the sender's counter
    return int(m[1])


class SequenceGap(RuleLinkFault, frozen=True, kw_only=True):
    """Skip `count` sequence numbers at a fraction `value` of the frames, as after lost frames."""

    name: ClassVar[str] = "sequence-gap"
    example: ClassVar[dict[str, Any]] = {"value": 0.2}
    takes_bytes: ClassVar[bool] = False
    takes_unknown: ClassVar[bool] = True
    # A new sequence number would break the signature, which covers the header.
    takes_sealed: ClassVar[bool] = False
    rule = staticmethod(skip_numbers)
    parameters: ClassVar[tuple[str, ...]] = ("value", "count")
    effect: ClassVar[Effect] = "renumber"
    remembers: ClassVar[int] = 2

    value: Share = 0.1
    count: Annotated[int, Meta(ge=1, le=255)] = 1
