"""Tape: what the core received and sent, kept in memory until a recorder takes it.

Frames, also of unknown messages or with a wrong CRC, go to tlogs: a big-endian Unix stamp in
microseconds before each frame. Readers step over such a frame by its length; other bytes would
cost them the frames behind (pymavlink loses one or two each time), so these go to a file of their
own, as stamp, length and bytes. `index` says for every received record which link it came on,
which of the two files it is in and how long it is.
"""

import struct
from dataclasses import dataclass, field

from mavproxy_fault.wire.frame import STX_V1, STX_V2
from mavproxy_fault.wire.parser import frame_span

STAMP = struct.Struct(">Q")
LENGTH = struct.Struct(">I")
INDEX = struct.Struct("<BBI")  # link, 1 if among the others, length in bytes


@dataclass(slots=True)
class CapturedBytes:
    """Bytes to append to the files of one session."""

    received: bytes
    received_other: bytes
    index: bytes
    sent: bytes
    sent_other: bytes


@dataclass(slots=True)
class CaptureBuffer:
    """Growing logs; `drain` hands over and empties each."""

    received: bytearray = field(default_factory=bytearray)
    received_other: bytearray = field(default_factory=bytearray)
    index: bytearray = field(default_factory=bytearray)
    sent: bytearray = field(default_factory=bytearray)
    sent_other: bytearray = field(default_factory=bytearray)
    drained: int = 0  # records received that were handed over

    @property
    def count(self) -> int:
        """How many records were received since the start."""
        return self.drained + len(self.index) // INDEX.size

    def resume_count(self, count: int) -> int:
        """Let the records handed over so far be so many: those that are in the files."""
        self.drained = count
        return count

    def receive(self, now_us: int, link: int, raw: bytes, *, is_frame: bool = False) -> None:
        """Note what came; of a frame that was verified nobody asks for its shape again."""
        if is_frame or has_frame_shape(raw):
            self.received += STAMP.pack(now_us) + raw
            self.index += INDEX.pack(link, 0, len(raw))
        else:
            self.received_other += STAMP.pack(now_us) + LENGTH.pack(len(raw)) + raw
            self.index += INDEX.pack(link, 1, len(raw))

    def send(self, due_us: int, raw: bytes) -> None:
        """Note what left."""
        if has_frame_shape(raw):
            self.sent += STAMP.pack(due_us) + raw
        else:
            self.sent_other += STAMP.pack(due_us) + LENGTH.pack(len(raw)) + raw

    def drain(self) -> CapturedBytes:
        """What came together since the last call."""
        contents = CapturedBytes(*(bytes(part) for part in self._parts))
        self.clear()
        return contents

    def clear(self) -> None:
        """Empty it; what it held counts as handed over."""
        self.drained = self.count
        for part in self._parts:
            part.clear()

    @property
    def _parts(self) -> tuple[bytearray, ...]:
        return self.received, self.received_other, self.index, self.sent, self.sent_other


def has_frame_shape(raw: bytes) -> bool:
    """Whether the bytes have the shape of one frame, right or wrong."""
    if not raw or raw[0] not in (STX_V1, STX_V2):
        return False
    place = frame_span(raw, 0)
    return place is not None and place[0] == len(raw)
