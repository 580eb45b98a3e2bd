"""RTCM 3 messages and how they travel in MAVLink TUNNEL.

A message stands between a three-byte header (0xD3, six zero bits, ten bits of length) and a
CRC-24Q of everything before it [1]_. MAVLink has no message for raw pseudoranges, so RTCM messages
travel in TUNNEL with the payload type below (types above 32767 are for private use [2]_). The first
byte of a TUNNEL payload is the flags byte of GPS_RTCM_DATA [2]_: bit 0 fragmented, bits 1 and 2 the
number of the fragment, bits 3 to 7 the sequence number of the message; up to 127 bytes of the
message follow. A fragmented message is complete when all four fragments are there, or all up to the
first that is not full; so a fragmented message of 254 or 381 bytes ends with an empty fragment.

References
----------
.. [1] RTCM 10403.3, section 4.
.. [2] MAVLink common message set, TUNNEL and GPS_RTCM_DATA.
"""

import struct
from collections.abc import Iterator

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

PREAMBLE = 0xD3
HEADER = 3
TRAILER = 3
BODY_MAX = 1023  # ten bits of length

PAYLOAD_TYPE = 33845  # TUNNEL.payload_type: 32768 + 1077
FRAGMENT_BYTES = 127
FRAGMENTS_MAX = 4
MESSAGE_MAX = FRAGMENTS_MAX * FRAGMENT_BYTES
SEQUENCES = 32
PENDING_MAX = 4  # incomplete messages kept at a time; far fewer than sequence numbers

CRC24Q_POLYNOMIAL = 0x1864CFB


def _crc_tables() -> tuple[tuple[int, ...], ...]:
    """CRC of each byte, and of each byte with one, two and three zero bytes after it."""
    first = []
    for byte in range(256):
        crc = byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (CRC24Q_POLYNOMIAL if crc & 0x800000 else 0)
        first.append(crc & 0xFFFFFF)
    tables = [tuple(first)]
    # One more zero byte behind is one more step of the register.
    for _ in range(3):
        tables.append(tuple((crc << 8 & 0xFFFFFF) ^ first[crc >> 16] for crc in tables[-1]))
    return tuple(tables)


_TABLES = _crc_tables()
CRC24Q_TABLE = _TABLES[0]


def crc24q(data: bytes) -> int:
    """CRC-24Q, start value zero, by four bytes at a time; zeros in front change nothing."""
    last, third, second, first = _TABLES
    crc = 0
    # Padded in front to whole words: with start value zero that leaves the CRC as it is.
    for word in struct.unpack(f">{len(data) + 3 >> 2}I", bytes(-len(data) % 4) + data):
        # The register has 24 bits: it meets the upper three bytes of the word.
        x = crc << 8 ^ word
        crc = first[x >> 24] ^ second[x >> 16 & 255] ^ third[x >> 8 & 255] ^ last[x & 255]
    return crc


def wrap_message(body: bytes) -> bytes:
    """A whole message around `body`, which starts with the twelve bits of the message number.

    Raises
    ------
    ValueError
        If the body is longer than 1023 bytes.
    """
    if len(body) > BODY_MAX:
        raise ValueError(f"an RTCM message holds {BODY_MAX} bytes, not {len(body)}")
    head = bytes((PREAMBLE, len(body) >> 8, len(body) & 0xFF)) + body
    return head + crc24q(head).to_bytes(TRAILER, "big")


def unwrap_message(message: bytes) -> bytes:
    """The body of one whole message.

    Raises
    ------
    ValueError
        If it is not one message with a right CRC.
    """
    if len(message) < HEADER + TRAILER or message[0] != PREAMBLE:
        raise ValueError("not an RTCM 3 message")
    if len(message) != HEADER + TRAILER + ((message[1] & 0x03) << 8 | message[2]):
        raise ValueError("RTCM message of the wrong length")
    if crc24q(message[:-TRAILER]) != int.from_bytes(message[-TRAILER:], "big"):
        raise ValueError("RTCM message with a wrong CRC")
    return message[HEADER:-TRAILER]


def message_number(message: bytes) -> int:
    """The number of a whole message (1077, 1019, ...); 0 if its body is too short for one."""
    if len(message) < HEADER + 2 + TRAILER:
        return 0
    return message[HEADER] << 4 | message[HEADER + 1] >> 4


def split_messages(data: bytes) -> Iterator[bytes]:
    """The whole messages with right CRC among `data`; anything else is passed over."""
    at = data.find(PREAMBLE)
    while 0 <= at <= len(data) - HEADER - TRAILER:
        end = at + HEADER + TRAILER + ((data[at + 1] & 0x03) << 8 | data[at + 2])
        message = data[at:end]
        right = int.from_bytes(message[-TRAILER:], "big")
        if end <= len(data) and crc24q(message[:-TRAILER]) == right:
            yield message
            at = data.find(PREAMBLE, end)
        else:
            # Again one byte on, as the length that was read may itself be junk.
            at = data.find(PREAMBLE, at + 1)


def split_fragments(message: bytes, sequence: int) -> list[bytes]:
    """TUNNEL payloads (flags byte and data) that carry one message.

    Raises
    ------
    ValueError
        If the message is longer than four fragments (508 bytes).
    """
    if len(message) > MESSAGE_MAX:
        raise ValueError(f"TUNNEL carries RTCM messages of {MESSAGE_MAX} bytes, not {len(message)}")
    flags = sequence % SEQUENCES << 3
    if len(message) <= FRAGMENT_BYTES:
        return [bytes((flags,)) + message]
    # Not rounded up: after full fragments, unless they are four, an empty one ends the message.
    count = min(len(message) // FRAGMENT_BYTES + 1, FRAGMENTS_MAX)
    return [
        bytes((flags | number << 1 | 1,))
        + message[number * FRAGMENT_BYTES : (number + 1) * FRAGMENT_BYTES]
        for number in range(count)
    ]


def tunnel_frames(
    message: bytes, sequence: int, *, seq: int = 0, system: int = 1, component: int = 51
) -> list[bytes]:
    """MAVLink 2 TUNNEL frames, to everybody, that carry one RTCM message.

    `sequence` counts RTCM messages, `seq` is the MAVLink sequence number of the first frame.
    """
    layout = message_layout("TUNNEL")
    return [
        build_frame(
            layout,
            {
                "payload_type": PAYLOAD_TYPE,
                "payload_length": len(payload),
                "payload": payload,
            },
            seq=(seq + number) & 0xFF,
            system=system,
            component=component,
        )
        for number, payload in enumerate(split_fragments(message, sequence))
    ]


def tunnel_payload(frame: Frame) -> bytes | None:
    """What a TUNNEL frame of our payload type carries (flags byte and data); None for any other."""
    if frame.layout.name != "TUNNEL" or frame.number("payload_type") != PAYLOAD_TYPE:
        return None
    start = frame.layout.fields["payload"].offset
    length = int(frame.number("payload_length"))
    # MAVLink 2 cuts trailing zeros, which may belong to the RTCM message.
    payload = frame.payload.ljust(frame.layout.length, b"\0")[start:]
    return payload[:length] if 0 < length <= len(payload) else None


class Reassembler:
    """Puts fragments of one sender together again; keeps at most four incomplete messages.

    A lost fragment loses its message. Fragments may come in any order.
    """

    __slots__ = ("_pending",)

    def __init__(self) -> None:
        self._pending: dict[int, dict[int, bytes]] = {}

    def add(self, payload: bytes) -> list[bytes]:
        """The RTCM messages, CRC checked, that this TUNNEL payload completes."""
        if not payload:
            return []
        flags, data = payload[0], payload[1:]
        sequence = flags >> 3
        if not flags & 1:
            # The number has come round: whatever waited under it will never be whole.
            self._pending.pop(sequence, None)
            return list(split_messages(data))
        parts = self._pending.setdefault(sequence, {})
        parts[flags >> 1 & 3] = data
        whole = join_fragments(parts)
        if whole is not None:
            del self._pending[sequence]
            return list(split_messages(whole))
        if len(self._pending) > PENDING_MAX:
            # Dictionaries keep their order, so that the first is the oldest.
            del self._pending[next(iter(self._pending))]
        return []


def join_fragments(parts: dict[int, bytes]) -> bytes | None:
    """All fragments up to the first that is not full, joined; None while one of them is missing."""
    whole = b""
    for number in range(FRAGMENTS_MAX):
        if number not in parts:
            return None
        whole += parts[number]
        if len(parts[number]) < FRAGMENT_BYTES:
            break
    return whole
