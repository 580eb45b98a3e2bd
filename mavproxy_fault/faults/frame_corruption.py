"""Damaged frames: wrong bytes, cut short, gaps in the sequence."""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import LinkFault, Outgoing
from mavproxy_fault.faults.loss import Share
from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator


class Corrupt(LinkFault, frozen=True, kw_only=True):
    """Replace `count` payload bytes at random in a share `value` of the frames.

    The CRC is left, so that receivers refuse the frame, or `redone`, so that they believe it.
    """

    name: ClassVar[str] = "corrupt"
    example: ClassVar[dict[str, Any]] = {"crc": "redone", "target": "HIL_SENSOR"}

    value: Share = 1.0
    count: Annotated[int, Meta(ge=1)] = 1
    crc: Literal["left", "redone"] = "left"

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Change some bytes, each into another one."""
        # No draw where every frame is hit: there is nothing to decide.
        if self.value < 1.0 and rng.random() >= self.value:
            return [Outgoing(t_us, frame)], None
        if isinstance(frame, bytes):
            return [Outgoing(t_us, self._mixed(frame, rng))], None
        payload = self._mixed(frame.payload, rng)
        if self.crc == "redone":
            return [Outgoing(t_us, frame.with_payload(payload))], None
        # Header and checksum as they were: receivers refuse such a frame.
        end = frame.payload_at + frame.length
        raw = frame.raw[: frame.payload_at] + payload + frame.raw[end:]
        return [Outgoing(t_us, raw)], None

    def _mixed(self, data: bytes, rng: "Generator") -> bytes:
        mixed = bytearray(data)
        places = rng.choice(len(mixed), min(self.count, len(mixed)), replace=False)
        # From 1: xor with 0 would leave a byte as it was.
        for place, change in zip(places, rng.integers(1, 256, len(places)), strict=True):
            mixed[place] ^= int(change)
        return bytes(mixed)


class Truncate(LinkFault, frozen=True, kw_only=True):
    """Cut the last `count` bytes off a share `value` of the frames."""

    name: ClassVar[str] = "truncate"
    example: ClassVar[dict[str, Any]] = {}

    value: Share = 1.0
    count: Annotated[int, Meta(ge=1)] = 4

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Send the head of the frame; at least one byte of it."""
        if self.value < 1.0 and rng.random() >= self.value:
            return [Outgoing(t_us, frame)], None
        raw = frame if isinstance(frame, bytes) else frame.raw
        return [Outgoing(t_us, raw[: max(len(raw) - self.count, 1)])], None


class SequenceGap(LinkFault, frozen=True, kw_only=True):
    """Add `count` to the sequence number at a share `value` of the frames, as if some were lost."""

    name: ClassVar[str] = "sequence-gap"
    example: ClassVar[dict[str, Any]] = {"value": 0.2}
    takes_bytes: ClassVar[bool] = False
    # A new sequence number would break the signature, which covers the header.
    takes_sealed: ClassVar[bool] = False

    value: Share = 0.1
    count: Annotated[int, Meta(ge=1, le=255)] = 1

    def new_state(self, start_us: int) -> int:
        """By how much the numbers are ahead."""
        return 0

    def apply(
        self, frame: Frame, t_us: int, state: int, rng: "Generator"
    ) -> tuple[list[Outgoing], int]:
        """Renumber the frame; once opened, a gap stays until the fault ends."""
        # The gap adds up and wraps at 256, as a sender's own counter does.
        ahead = (state + self.count * (rng.random() < self.value)) & 0xFF
        if not ahead:
            return [Outgoing(t_us, frame)], 0
        raw = bytearray(frame.raw)
        # Sequence number: the third byte of version 1, the fifth of version 2.
        at = 4 if frame.version == 2 else 2
        raw[at] = (raw[at] + ahead) & 0xFF
        return [Outgoing(t_us, Frame(bytes(raw), frame.layout).with_payload(frame.payload))], ahead
