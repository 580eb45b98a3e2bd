"""Corrupted frames: wrong bytes, truncation, gaps in the sequence number."""

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import Generator, Outgoing
from mavproxy_fault.fault_parts.memory import Memory
from mavproxy_fault.fault_parts.rules import (
    Drawn,
    Effect,
    Numbers,
    RuleLinkFault,
    choose_place,
    link_rule,
)
from mavproxy_fault.faults.loss import Share
from mavproxy_fault.faults.timing import ShareFault
from mavproxy_fault.wire.frame import Frame


def mix_bytes(data: Any, at: int, size: int, count: int, draws: Any) -> None:
    """Change `count` of `size` bytes, each to another value; a rule, with two draws for each."""
    for n in range(count):
        data[at + choose_place(n, count, size, draws)] ^= 1 + int(draws[count + n] * 255)


class Corrupt(ShareFault, frozen=True, kw_only=True):
    """Replace `count` random bytes in a fraction `value` of the frames, in the payload or anywhere.

    The CRC is `left` unchanged, so that receivers reject the frame, or `redone` to match; a wrong
    byte in the header may cost them the next frames too. With the probability `correlation` a frame
    shares the choice of the one before.
    """

    name: ClassVar[str] = "corrupt"
    example: ClassVar[dict[str, Any]] = {"crc": "redone", "target": "HIL_SENSOR"}
    effect: ClassVar[Effect] = "mix"
    drawn: ClassVar[Drawn] = "random"

    count: Annotated[int, Meta(ge=1)] = 1
    crc: Literal["left", "redone"] = "left"
    part: Literal["payload", "frame"] = "payload"

    def __post_init__(self) -> None:
        if self.part == "frame" and self.crc == "redone":
            raise ValueError("part: frame damages the CRC too; leave out crc: redone")

    def numbers(self) -> Numbers:
        """Return share, number of bytes, correlation, whether the CRC matches (-1: may change)."""
        crc = -1.0 if self.part == "frame" else float(self.crc == "redone")
        return self.value, float(self.count), self.correlation, crc

    def outcome(
        self, frame: Frame | bytes, t_us: int, memory: Memory, rng: Generator
    ) -> list[Outgoing]:
        """Replace some bytes; of what is not a frame, any of them."""
        raw = frame if isinstance(frame, bytes) else frame.raw
        at, size = 0, len(raw)
        if isinstance(frame, Frame) and self.part == "payload":
            at, size = frame.payload_at, frame.length
        number, mixed = self.choose(len(raw), t_us, memory, rng), bytearray(raw)
        if not number:
            return [Outgoing(t_us, frame)]
        count = min(number, size)
        mix_bytes(mixed, at, size, count, rng.random(2 * count).tolist())
        if isinstance(frame, Frame) and self.crc == "redone":
            return [Outgoing(t_us, frame.with_payload(bytes(mixed[at : at + size])))]
        # Header and checksum stay, so that receivers reject the frame.
        return [Outgoing(t_us, bytes(mixed))]


class Truncate(ShareFault, frozen=True, kw_only=True):
    """Cut the last `count` bytes off a fraction `value` of the frames.

    With the probability `correlation` a frame shares the choice of the one before.
    """

    name: ClassVar[str] = "truncate"
    example: ClassVar[dict[str, Any]] = {}
    effect: ClassVar[Effect] = "cut"
    parameters: ClassVar[tuple[str, ...]] = ("value", "count", "correlation")

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
