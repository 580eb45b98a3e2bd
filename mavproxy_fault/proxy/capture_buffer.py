"""Capture buffer: received and sent bytes in memory until the recorder writes them.

Frames, including unknown messages and wrong CRCs, are stored as tlog records: a big-endian Unix
timestamp in microseconds, then the frame. Log readers skip such a frame by its length. Any other
bytes would cost them the following frames (pymavlink loses one or two each time), so these have a
file of their own, with timestamp, length and bytes. `index` has the link, file and length of every
received record. Signing keys (SETUP_SIGNING) are stored as zeros.
"""

import struct
from dataclasses import dataclass, field, replace

from mavproxy_fault.wire.frame import frame_header
from mavproxy_fault.wire.signing import SETUP_SIGNING, mask_signing_keys

STAMP = struct.Struct(">Q")
LENGTH = struct.Struct(">I")
KEY_MESSAGE = SETUP_SIGNING.to_bytes(3, "little")  # its id in a header of MAVLink 2
INDEX = struct.Struct("<BBI")  # link, 1 if in the file of other bytes, length in bytes


@dataclass(slots=True)
class CaptureBuffer:
    """Growing logs, to be appended to the files of a session; `drain` hands them over."""

    received: bytearray = field(default_factory=bytearray)
    received_other: bytearray = field(default_factory=bytearray)
    index: bytearray = field(default_factory=bytearray)
    sent: bytearray = field(default_factory=bytearray)
    sent_other: bytearray = field(default_factory=bytearray)
    drained: int = 0  # received records already returned by `drain`

    @property
    def count(self) -> int:
        """Number of records received since the start."""
        return self.drained + len(self.index) // INDEX.size

    def resume_count(self, count: int) -> int:
        """Restart counting for new files, which begin with `count` records; return it."""
        self.drained = count
        return count

    def receive(self, now_us: int, link: int, raw: bytes, *, is_frame: bool = False) -> None:
        """Store received bytes; `is_frame` saves checking a verified frame's shape again."""
        if not is_frame or raw[7:10] == KEY_MESSAGE:
            raw = mask_signing_keys(raw)
        if is_frame or has_frame_shape(raw):
            self.received += STAMP.pack(now_us) + raw
            self.index += INDEX.pack(link, 0, len(raw))
        else:
            self.received_other += STAMP.pack(now_us) + LENGTH.pack(len(raw)) + raw
            self.index += INDEX.pack(link, 1, len(raw))

    def send(self, due_us: int, raw: bytes) -> None:
        """Store sent bytes."""
        is_frame = has_frame_shape(raw)
        if not is_frame or raw[7:10] == KEY_MESSAGE:
            raw = mask_signing_keys(raw)
        if is_frame:
            self.sent += STAMP.pack(due_us) + raw
        else:
            self.sent_other += STAMP.pack(due_us) + LENGTH.pack(len(raw)) + raw

    def drain(self) -> "CaptureBuffer":
        """Return everything stored since the last call, which counts as drained, and forget it."""
        contents = replace(self)
        self.drained = self.count
        self.received, self.received_other, self.index = bytearray(), bytearray(), bytearray()
        self.sent, self.sent_other = bytearray(), bytearray()
        return contents


def has_frame_shape(raw: bytes) -> bool:
    """Whether the bytes have the length and start byte of one frame, whatever its CRC."""
    return bool(raw) and frame_header(raw, 0, len(raw))[2] == len(raw)
