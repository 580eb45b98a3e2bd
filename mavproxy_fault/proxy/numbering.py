"""Sequence numbers of the frames that the proxy makes itself."""

from collections.abc import Sequence

from mavproxy_fault.proxy.senders import NEXT_SEQ, UNKNOWN
from mavproxy_fault.wire.frame import Frame, frame_payload


class Numbering:
    """Lets a made frame go on where the count of its sender stands.

    Nobody counts a loss where all frames of a sender are the proxy's own. In the name of a sender
    that speaks for itself one frame too many stays one, whatever its number: a receiver that takes
    differences modulo 256 then counts 255 lost. Frames made between two of the sender's are
    numbered on, so that they cost this once.
    """

    def __init__(self, senders: Sequence[int]) -> None:
        self._senders = senders
        self._made: dict[int, tuple[int, int]] = {}  # the sender's own next number, and ours

    def number_frame(self, frame: Frame) -> bytes:
        """The bytes of a made frame with the number that its sender's next frame would bear."""
        sender = frame.system << 8 | frame.component
        expected = self._senders[NEXT_SEQ + sender]
        counted_from, seq = self._made.get(sender, (UNKNOWN, 0))
        if counted_from != expected:  # the sender has spoken since
            seq = expected
        self._made[sender] = expected, (seq + 1) & 0xFF
        return frame_payload(
            frame.layout, frame.payload, seq=seq, system=frame.system, component=frame.component
        )
