"""Sequence numbers of the frames that the proxy makes itself."""

from collections.abc import Sequence

from mavproxy_fault.proxy.senders import NEXT_SEQ, UNKNOWN
from mavproxy_fault.wire.frame import Frame, frame_payload


class Numbering:
    """Continues the sequence numbers of the sender in whose name a frame is created.

    If all frames of a sender come from the proxy, receivers count no loss. An extra frame in the
    name of another sender cannot be hidden: a receiver that takes differences modulo 256 counts
    255 lost frames. Consecutive extra frames are numbered on, so that this happens only once.
    """

    def __init__(self, senders: Sequence[int]) -> None:
        self._senders = senders
        self._made: dict[int, tuple[int, int]] = {}  # next numbers of the sender and of the proxy

    def number_frame(self, frame: Frame) -> bytes:
        """Encode a frame with the sequence number expected next of its sender."""
        sender = frame.system << 8 | frame.component
        expected = self._senders[NEXT_SEQ + sender]
        counted_from, seq = self._made.get(sender, (UNKNOWN, 0))
        if counted_from != expected:  # the sender has sent frames since
            seq = expected
        self._made[sender] = expected, (seq + 1) & 0xFF
        return frame_payload(
            frame.layout, frame.payload, seq=seq, system=frame.system, component=frame.component
        )
