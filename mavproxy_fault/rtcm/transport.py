"""RTCM 3 messages [1]_ and their transport in MAVLink TUNNEL [2]_ (docs/gnss.md, "Pseudoranges on
MAVLink").

References
----------
.. [1] RTCM 10403.3, section 4.
.. [2] MAVLink common message set, TUNNEL and GPS_RTCM_DATA.
"""

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
PENDING_MAX = 4  # incomplete messages stored per sender; far fewer than sequence numbers
SENDERS_MAX = 16  # then those of all senders count together

CRC24Q_POLYNOMIAL = 0x1864CFB


def _crc_of_byte(byte: int) -> int:
    """Return the CRC of one byte."""
    crc = byte << 16
    for _ in range(8):
        crc = crc << 1 ^ (CRC24Q_POLYNOMIAL if crc & 0x800000 else 0)
    return crc


_TABLE = tuple(map(_crc_of_byte, range(256)))


def crc24q(data: bytes) -> int:
    """Compute CRC-24Q with start value zero."""
    crc = 0
    for byte in data:
        crc = crc << 8 & 0xFFFFFF ^ _TABLE[crc >> 16 ^ byte]
    return crc


def wrap_message(body: bytes) -> bytes:
    """Add header and CRC to `body`, which starts with the twelve bits of the message number.

    Raises
    ------
    ValueError
        If the body is longer than 1023 bytes.
    """
    if len(body) > BODY_MAX:
        raise ValueError(f"an RTCM message has at most {BODY_MAX} bytes, not {len(body)}")
    head = bytes((PREAMBLE, len(body) >> 8, len(body) & 0xFF)) + body
    return head + crc24q(head).to_bytes(TRAILER, "big")


def unwrap_message(message: bytes) -> bytes:
    """Return the body of one complete message.

    Raises
    ------
    ValueError
        If it is not one message with a valid CRC.
    """
    if [*split_messages(message)] != [message]:
        raise ValueError("not one RTCM 3 message with a valid CRC")
    return message[HEADER:-TRAILER]


def message_number(message: bytes) -> int:
    """Return the number of a message (1077, 1019, ...); 0 if its body is too short."""
    if len(message) < HEADER + 2 + TRAILER:
        return 0
    return message[HEADER] << 4 | message[HEADER + 1] >> 4


def split_messages(data: bytes) -> Iterator[bytes]:
    """Yield the complete messages with valid CRC in `data`; other bytes are skipped."""
    at = data.find(PREAMBLE)
    while 0 <= at <= len(data) - HEADER - TRAILER:
        end = at + HEADER + TRAILER + ((data[at + 1] & 0x03) << 8 | data[at + 2])
        message = data[at:end]
        right = int.from_bytes(message[-TRAILER:], "big")
        if end <= len(data) and crc24q(message[:-TRAILER]) == right:
            yield message
            at = data.find(PREAMBLE, end)
        else:
            # Continue one byte later, since the length may be junk.
            at = data.find(PREAMBLE, at + 1)


def split_fragments(message: bytes, sequence: int) -> list[bytes]:
    """Split one message into TUNNEL payloads (flags byte and data).

    Raises
    ------
    ValueError
        If the message is longer than four fragments (508 bytes).
    """
    if len(message) > MESSAGE_MAX:
        raise ValueError(f"an RTCM message in TUNNEL has {len(message)} > {MESSAGE_MAX} bytes")
    flags = sequence % SEQUENCES << 3
    if len(message) <= FRAGMENT_BYTES:
        return [bytes((flags,)) + message]
    # Not rounded up: fewer than four full fragments are followed by an empty one.
    count = min(len(message) // FRAGMENT_BYTES + 1, FRAGMENTS_MAX)
    return [
        bytes((flags | number << 1 | 1,))
        + message[number * FRAGMENT_BYTES : (number + 1) * FRAGMENT_BYTES]
        for number in range(count)
    ]


def tunnel_frames(
    message: bytes, sequence: int, *, seq: int = 0, system: int = 1, component: int = 51
) -> list[bytes]:
    """Build broadcast MAVLink 2 TUNNEL frames that carry one RTCM message.

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
    """Return flags byte and data of a TUNNEL frame of our payload type; None for other frames."""
    if frame.layout.name != "TUNNEL" or frame.number("payload_type") != PAYLOAD_TYPE:
        return None
    start = frame.layout.fields["payload"].offset
    length = int(frame.number("payload_length"))
    # Restore truncated trailing zeros, which may belong to the RTCM message.
    payload = frame.payload.ljust(frame.layout.length, b"\0")[start:]
    return payload[:length] if 0 < length <= len(payload) else None


class Reassembler:
    """Reassembles the fragments of any number of senders; stores a few incomplete messages.

    A lost fragment loses its message. Fragments may arrive in any order.
    """

    __slots__ = ("_pending",)

    def __init__(self) -> None:
        self._pending: dict[tuple[int, int], dict[int, bytes]] = {}

    def add(self, payload: bytes, sender: int = 0) -> list[bytes]:
        """Add a TUNNEL payload; return the RTCM messages that it completes, with valid CRC."""
        if not payload:
            return []
        flags, data = payload[0], payload[1:]
        key = sender, flags >> 3
        if not flags & 1:
            # The sequence number is in use again: an older message with it stays incomplete.
            self._pending.pop(key, None)
            return list(split_messages(data))
        parts = self._pending.setdefault(key, {})
        parts[flags >> 1 & 3] = data
        whole = join_fragments(parts)
        if whole is not None:
            del self._pending[key]
            return list(split_messages(whole))
        own = [known for known in self._pending if known[0] == sender]
        # A dictionary has the oldest first.
        for old in own[:-PENDING_MAX] or [*self._pending][: -SENDERS_MAX * PENDING_MAX]:
            del self._pending[old]
        return []


def join_fragments(parts: dict[int, bytes]) -> bytes | None:
    """Join all fragments up to the first that is not full; None while one is missing."""
    whole = b""
    for number in range(FRAGMENTS_MAX):
        if number not in parts:
            return None
        whole += parts[number]
        if len(parts[number]) < FRAGMENT_BYTES:
            break
    return whole
