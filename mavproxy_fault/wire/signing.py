"""MAVLink 2 signatures: verify, sign and strip.

The signature is the first 48 bits of SHA-256 over key, header, payload, CRC, link id and timestamp.
The timestamp counts units of 10 us since 2015-01-01 and must increase within a stream (one system,
component and link id) [1]_.

References
----------
.. [1] MAVLink developer guide, "Message Signing".
"""

import hashlib
from array import array
from collections.abc import MutableSequence

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import (
    CRC_LENGTH,
    SIGNATURE_LENGTH,
    SIGNED,
    STX_V2,
    Frame,
    checksum,
)

DIGEST_LENGTH = 6
KEY_LENGTH = 32
STREAMS = 4096  # chosen: with the key a peer could make up 2^24
SETUP_SIGNING = message_layout("SETUP_SIGNING").id
KEY_AT = message_layout("SETUP_SIGNING").fields["secret_key"].offset
_SETUP_SIGNING = SETUP_SIGNING.to_bytes(3, "little")
STAMP_AT = slice(-12, -6)  # little-endian, after the link id


def derive_key(passphrase: str) -> bytes:
    """Derive a key from a passphrase as Mission Planner and QGroundControl do: by SHA-256."""
    return hashlib.sha256(passphrase.encode()).digest()


def _digest(key: bytes, raw: bytes) -> bytes:
    return hashlib.sha256(key + raw[:-DIGEST_LENGTH]).digest()[:DIGEST_LENGTH]


def stream_cell(streams: MutableSequence[int], stream: int) -> int:
    """Return where a stream's least acceptable timestamp is, -1 without room for another stream.

    A rule in numbers only, which `compiled` compiles. `streams` has two numbers for each of
    `STREAMS`: which it is, plus one, and that timestamp.
    """
    row = (stream ^ stream >> 9) % STREAMS
    for _ in range(STREAMS):
        if streams[2 * row] == 0:
            streams[2 * row] = stream + 1
        if streams[2 * row] == stream + 1:
            return 2 * row + 1
        row = (row + 1) % STREAMS
    return -1


def next_cell(streams: MutableSequence[int], sender: int, link_id: int, stamp: int) -> int:
    """Return the `stream_cell` of a signed frame; -1 if it is no newer than the stream's last.

    A rule in numbers too. A replayed frame has a correct signature but an old timestamp.
    """
    cell = stream_cell(streams, sender << 8 | link_id)
    return cell if cell >= 0 and stamp >= streams[cell] else -1


def strip_signature(frame: Frame) -> Frame:
    """Remove a frame's signature: clear the flag, drop 13 bytes, recompute the CRC."""
    raw = frame.raw[:2] + bytes((frame.raw[2] & ~SIGNED,)) + frame.raw[3 : -SIGNATURE_LENGTH - 2]
    return Frame(raw + checksum(raw[1:], frame.layout.crc_extra), frame.layout)


def mask_signing_keys(raw: bytes) -> bytes:
    """Return bytes with zeros in place of every key in a SETUP_SIGNING, for a log.

    A single frame keeps its length, and whether its checksum was correct; so a replay of the masked
    log gives what masking gave in the session.
    """
    masked = bytearray(raw)
    at = raw.find(_SETUP_SIGNING, 7)
    while at >= 0:
        if raw[at - 7] == STX_V2:
            start = at + len(_SETUP_SIGNING)
            end = min(start + raw[at - 6], len(raw))
            # The length of a damaged frame may be wrong.
            last = end if at == 7 else len(raw)
            masked[start + KEY_AT : last] = bytes(max(last - start - KEY_AT, 0))
            if at == 7 and end + CRC_LENGTH <= len(raw):
                extra = message_layout("SETUP_SIGNING").crc_extra
                crc, right = checksum(bytes(masked[1:end]), extra), checksum(raw[1:end], extra)
                if raw[end : end + CRC_LENGTH] != right:
                    crc = bytes(byte ^ 0xFF for byte in crc)
                masked[end : end + CRC_LENGTH] = crc
        at = raw.find(_SETUP_SIGNING, at + 1)
    return bytes(masked)


class Signing:
    """The proxy's policy for signed frames.

    With a key, frames with a correct signature may be changed and are then signed again; all
    others are sealed: forwarded unchanged. `strip` removes the signatures of verified frames, or
    of all frames if there is no key. `streams` has the state of `stream_cell`.
    """

    def __init__(self, key: bytes | None = None, *, strip: bool = False) -> None:
        self.key = key
        self.strip = strip
        self.streams = array("q", bytes(16 * STREAMS))

    def verify(self, frame: Frame) -> bool:
        """Whether a signed frame's signature is correct and newer than the stream's last one."""
        raw = frame.raw
        if self.key is None or raw[-DIGEST_LENGTH:] != _digest(self.key, raw):
            return False
        stamp, sender = int.from_bytes(raw[STAMP_AT], "little"), frame.system << 8 | frame.component
        cell = next_cell(self.streams, sender, raw[-SIGNATURE_LENGTH], stamp)
        if cell >= 0:
            self.streams[cell] = stamp + 1
        return cell >= 0

    def verify_incoming(self, frame: Frame) -> tuple[Frame, bool]:
        """Return a signed frame, stripped if requested, and whether it is sealed."""
        if self.key is not None and not self.verify(frame):
            return frame, True
        if self.strip:
            return strip_signature(frame), False
        return frame, self.key is None

    def sign_outgoing(self, frame: Frame) -> Frame:
        """Sign a changed frame again if there is a key, with its link id and timestamp."""
        if self.key is None:
            return frame
        # With a newer timestamp the sender's own next frames would look replayed.
        return Frame(frame.raw[:-DIGEST_LENGTH] + _digest(self.key, frame.raw), frame.layout)
