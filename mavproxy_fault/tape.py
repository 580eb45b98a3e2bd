"""Tape: what the core received, sent and labelled, kept in memory until a recorder takes it.

The bytes are tlogs: a big-endian Unix stamp in microseconds before each frame. What is no frame is
kept as it is behind its own stamp; readers of tlogs skip it by searching the next plausible stamp.
`index` says for every received record which link it came on and how long it is, so that a replay
needs no search.
"""

import struct
from dataclasses import dataclass, field

STAMP = struct.Struct(">Q")
INDEX = struct.Struct("<BxH")  # link, length in bytes


@dataclass(slots=True)
class Tape:
    """Growing logs; `take` hands over and empties each."""

    received: bytearray = field(default_factory=bytearray)
    sent: bytearray = field(default_factory=bytearray)
    index: bytearray = field(default_factory=bytearray)

    def receive(self, now_us: int, link: int, raw: bytes) -> None:
        """Note what came."""
        self.received += STAMP.pack(now_us) + raw
        self.index += INDEX.pack(link, len(raw))

    def send(self, due_us: int, raw: bytes) -> None:
        """Note what left."""
        self.sent += STAMP.pack(due_us) + raw

    def take(self) -> tuple[bytes, bytes, bytes]:
        """Received, sent and index since the last call."""
        taken = bytes(self.received), bytes(self.sent), bytes(self.index)
        self.received.clear()
        self.sent.clear()
        self.index.clear()
        return taken
