"""Signed frames, as a vehicle or a ground station with the key sends them."""

from mavproxy_fault.wire.frame import SIGNED, Frame, checksum
from mavproxy_fault.wire.signing import DIGEST_LENGTH, Signing


def sign_frame(frame: Frame, key: bytes, link_id: int, stamp: int) -> Frame:
    """Sign an unsigned MAVLink 2 frame; `stamp` is in units of 10 us since 2015-01-01."""
    raw = frame.raw[:2] + bytes((frame.raw[2] | SIGNED,)) + frame.raw[3:-2]
    raw += checksum(raw[1:], frame.layout.crc_extra)
    raw += bytes((link_id,)) + stamp.to_bytes(6, "little") + bytes(DIGEST_LENGTH)
    return Signing(key).sign_outgoing(Frame(raw, frame.layout))
