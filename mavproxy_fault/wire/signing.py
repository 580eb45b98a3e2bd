"""MAVLink 2 signatures: verify, make, strip.

The signature is the first 48 bits of SHA-256 over key, header, payload, CRC, link id and time
stamp; the stamp counts 10 us since 2015-01-01 and must grow within a stream, which is one system,
component and link id [1]_.

References
----------
.. [1] MAVLink developer guide, "Message Signing".
"""

import hashlib
from dataclasses import dataclass, field

from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.wire.frame import SIGNATURE_LENGTH, SIGNED, Frame

KEY_LENGTH = 32
DIGEST_LENGTH = 6
STAMP_AT = slice(-12, -6)  # little-endian, after the link id


def derive_key(passphrase: str) -> bytes:
    """The key of a passphrase as ground stations derive it: its SHA-256."""
    # As Mission Planner and QGroundControl do.
    return hashlib.sha256(passphrase.encode()).digest()


def _digest(key: bytes, raw: bytes) -> bytes:
    return hashlib.sha256(key + raw[:-DIGEST_LENGTH]).digest()[:DIGEST_LENGTH]


@dataclass(slots=True)
class Verifier:
    """Checks signatures with one key and remembers the newest stamp of each stream."""

    key: bytes
    newest: dict[tuple[int, int, int], int] = field(default_factory=dict)

    def verify(self, frame: Frame) -> bool:
        """Whether a signed frame's signature is right and newer than the stream's last one."""
        raw = frame.raw
        if raw[-DIGEST_LENGTH:] != _digest(self.key, raw):
            return False
        stream = (frame.system, frame.component, raw[-SIGNATURE_LENGTH])
        stamp = int.from_bytes(raw[STAMP_AT], "little")
        # A replayed frame has a right signature but an old stamp.
        if stamp <= self.newest.get(stream, -1):
            return False
        self.newest[stream] = stamp
        return True


def resign_frame(frame: Frame, key: bytes) -> Frame:
    """A changed frame signed again, with the link id and stamp it came with."""
    # With a newer stamp the sender's own next frames would look like replayed ones.
    return Frame(frame.raw[:-DIGEST_LENGTH] + _digest(key, frame.raw), frame.layout)


def sign_frame(frame: Frame, key: bytes, link_id: int, stamp: int) -> Frame:
    """An unsigned MAVLink 2 frame with a signature; `stamp` in 10 us since 2015-01-01."""
    raw = frame.raw[:2] + bytes((frame.raw[2] | SIGNED,)) + frame.raw[3:-2]
    crc = mcrf4xx(raw[1:] + bytes((frame.layout.crc_extra,)))
    raw += crc.to_bytes(2, "little") + bytes((link_id,)) + stamp.to_bytes(6, "little")
    return Frame(raw + _digest(key, raw + bytes(DIGEST_LENGTH)), frame.layout)


def strip_signature(frame: Frame) -> Frame:
    """A signed frame without its signature: flag cleared, 13 bytes less, CRC redone."""
    raw = frame.raw[:2] + bytes((frame.raw[2] & ~SIGNED,)) + frame.raw[3 : -SIGNATURE_LENGTH - 2]
    crc = mcrf4xx(raw[1:] + bytes((frame.layout.crc_extra,)))
    return Frame(raw + crc.to_bytes(2, "little"), frame.layout)


class Signing:
    """What the proxy does with signed frames.

    With a key, frames whose signature is right may be changed and are then signed again; others
    stay sealed. `strip` takes the signatures off: of the frames that verify, or without a key of
    all.
    """

    def __init__(self, key: bytes | None = None, *, strip: bool = False) -> None:
        self.key = key
        self.strip = strip
        self._verifier = Verifier(key or b"")

    def verify_incoming(self, frame: Frame) -> tuple[Frame, bool]:
        """A signed frame as it goes on, and whether it must not be changed."""
        if self.key is not None and not self._verifier.verify(frame):
            return frame, True
        if self.strip:
            return strip_signature(frame), False
        return frame, self.key is None

    def sign_outgoing(self, frame: Frame) -> Frame:
        """A changed signed frame, signed again if there is a key."""
        return frame if self.key is None else resign_frame(frame, self.key)
