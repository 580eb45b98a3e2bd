"""Frames: the bytes of one verified MAVLink message, and reading and patching its fields.

MAVLink 2: FD, LEN, incompat, compat, SEQ, system, component, id (3), payload, CRC (2),
           signature (13)
MAVLink 1: FE, LEN, SEQ, system, component, id, payload, CRC (2)

The CRC is CRC-16/MCRF4XX over everything after the start byte, then the message's CRC extra [1]_.

References
----------
.. [1] MAVLink developer guide, "Packet Serialization".
"""

import struct
from collections.abc import Mapping, Sequence

from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.wire.dialect import Layout

STX_V1 = 0xFE
STX_V2 = 0xFD
SIGNED = 0x01  # incompat flag
SIGNATURE_LENGTH = 13
CRC_LENGTH = 2
HEADER_V1 = 6
HEADER_V2 = 10

# By struct code.
INTEGER_LIMITS = {
    "B": (0, 0xFF),
    "b": (-0x80, 0x7F),
    "H": (0, 0xFFFF),
    "h": (-0x8000, 0x7FFF),
    "I": (0, 0xFFFFFFFF),
    "i": (-0x80000000, 0x7FFFFFFF),
    "Q": (0, 0xFFFFFFFFFFFFFFFF),
    "q": (-0x8000000000000000, 0x7FFFFFFFFFFFFFFF),
}
_STX = bytes((STX_V2,))
_HEAD = struct.Struct("<6BHB")  # length, flags, sequence, sender and message id of MAVLink 2
# The largest finite float32: a larger value would pack to infinity or raise.
FLOAT_MAX = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]

Number = int | float
Packing = tuple[struct.Struct, tuple[tuple[str, object], ...]]

_packings: dict[int, Packing] = {}  # by message id


class Frame:
    """The received bytes of one message with a correct CRC, and its decoded header.

    `raw` is never changed; `with_payload` returns a new frame.
    """

    __slots__ = ("component", "id", "layout", "length", "payload_at", "raw", "seq", "system")

    def __init__(self, raw: bytes, layout: Layout) -> None:
        self.raw = raw
        self.layout = layout
        self.id = layout.id
        self.length = raw[1]
        if raw[0] == STX_V2:
            self.payload_at = HEADER_V2
            self.seq, self.system, self.component = raw[4], raw[5], raw[6]
        else:
            self.payload_at = HEADER_V1
            self.seq, self.system, self.component = raw[2], raw[3], raw[4]

    def __repr__(self) -> str:
        return f"<{self.layout.name} v{self.version} {self.system}/{self.component} #{self.seq}>"

    @property
    def version(self) -> int:
        """1 or 2."""
        return 2 if self.raw[0] == STX_V2 else 1

    @property
    def signed(self) -> bool:
        """Whether a signature follows the CRC."""
        return self.raw[0] == STX_V2 and bool(self.raw[2] & SIGNED)

    @property
    def payload(self) -> bytes:
        """The payload as sent; MAVLink 2 truncates trailing zeros."""
        return self.raw[self.payload_at : self.payload_at + self.length]

    def read(self, name: str, index: int = 0) -> Number | bytes:
        """Read one element of a field (a `char` array as text); truncated bytes read as 0."""
        field = self.layout.fields[name]
        if field.type == "char":
            text = self.payload[field.offset : field.offset + field.length]
            return text.split(b"\0", 1)[0]
        start = field.offset + index * field.size
        value: Number
        if start + field.size <= self.length:
            value = field.packer.unpack_from(self.raw, self.payload_at + start)[0]
        else:
            # The payload was truncated inside this field: the missing bytes are zeros.
            data = self.payload[start : start + field.size].ljust(field.size, b"\0")
            value = field.packer.unpack(data)[0]
        return value

    def number(self, name: str, index: int = 0) -> Number:
        """Read one element of a numeric field."""
        value = self.read(name, index)
        if isinstance(value, bytes):
            raise TypeError(f"{self.layout.name}.{name} holds text")
        return value

    def values(self) -> dict[str, Number | bytes | tuple[Number, ...]]:
        """Read all fields by name; arrays as tuples, text as bytes."""
        return {
            field.name: self.read(field.name)
            if field.count == 0 or field.type == "char"
            else tuple(self.number(field.name, i) for i in range(field.count))
            for field in self.layout.fields.values()
        }

    def with_payload(self, payload: bytes) -> "Frame":
        """Return this frame with another payload and updated length and CRC."""
        raw, layout = self.raw, self.layout
        body = bytes((len(payload),)) + raw[2 : self.payload_at] + payload
        # Unchanged; the holder of the key signs again.
        signature = raw[self.payload_at + self.length + 2 :]
        return Frame(raw[:1] + body + checksum(body, layout.crc_extra) + signature, layout)


def frame_header(data: Sequence[int], at: int, size: int) -> tuple[int, int, int]:
    """Return header length, message id and end of the frame at `at`, zeros if there is none.

    A rule in numbers only, which is compiled too. Of `data` the first `size` bytes are read; the
    end may lie beyond them.
    """
    if at + HEADER_V1 > size:
        return 0, 0, 0
    if data[at] == STX_V2 and at + HEADER_V2 <= size:
        signature = SIGNATURE_LENGTH if data[at + 2] & SIGNED else 0
        number = data[at + 7] + 0x100 * data[at + 8] + 0x10000 * data[at + 9]
        return HEADER_V2, number, at + HEADER_V2 + data[at + 1] + CRC_LENGTH + signature
    if data[at] == STX_V1:
        # numba: a sum is of the same type as above
        return HEADER_V1, 0 + data[at + 5], at + HEADER_V1 + data[at + 1] + CRC_LENGTH
    return 0, 0, 0


def whole_frame(data: Sequence[int], at: int, size: int) -> tuple[int, int, int]:
    """Return the `frame_header` of a frame that is all within `size` bytes, else zeros; a rule."""
    head, number, end = frame_header(data, at, size)
    return (head, number, end) if end <= size else (0, 0, 0)


def has_unknown_flags(data: Sequence[int], at: int) -> bool:
    """Whether a frame's incompat flags forbid a receiver to read it; a rule in numbers only."""
    return data[at] == STX_V2 and data[at + 2] & ~SIGNED != 0


def sent_length(payload: Sequence[int], begin: int, sent: int, changed: int) -> int:
    """Return the length of a changed payload of which `sent` bytes were sent; a rule in numbers.

    It grows only as far as the change, up to `changed`, reaches into truncated zeros. The payload
    starts at `begin`.
    """
    while changed > sent and payload[begin + changed - 1] == 0:
        changed -= 1
    return max(changed, sent)


def checksum(body: bytes, extra: int) -> bytes:
    """Return the checksum of a frame: of all between start byte and checksum, and its CRC extra."""
    return mcrf4xx(body + bytes((extra,))).to_bytes(2, "little")


def build_frame(
    layout: Layout,
    values: Mapping[str, object],
    *,
    seq: int = 0,
    system: int = 1,
    component: int = 1,
) -> bytes:
    """Encode a MAVLink 2 frame; omitted fields are zero, arrays are sequences, text is bytes.

    Raises
    ------
    KeyError
        If `values` names a field the message does not have.
    struct.error
        If a value does not fit its field.
    """
    packer, blanks = _packings.get(layout.id) or _make_packing(layout)
    flat: list[object] = []
    for name, blank in blanks:
        value = values.get(name, blank)
        if isinstance(blank, tuple):
            items: tuple[object, ...] = tuple(value)  # type: ignore[arg-type]
            flat += items + blank[len(items) :]
        else:
            flat.append(_fit_bytes(name, value, blank) if isinstance(blank, bytes) else value)
    if not values.keys() <= layout.fields.keys():
        unknown = sorted(values.keys() - layout.fields.keys())
        raise KeyError(f"{layout.name} has no field {', '.join(unknown)}")
    return frame_payload(layout, packer.pack(*flat), seq=seq, system=system, component=component)


def _fit_bytes(name: str, value: object, blank: bytes) -> bytes:
    """Convert text (truncated if too long) or a byte array (an error if too long) to bytes."""
    data: bytes = bytes(value)  # type: ignore[call-overload]
    if blank and len(data) > len(blank):
        raise struct.error(f"{name} holds {len(blank)} bytes, not {len(data)}")
    return data


def frame_payload(
    layout: Layout, payload: bytes, *, seq: int, system: int, component: int
) -> bytes:
    """Encode a MAVLink 2 frame around a payload, whose trailing zeros are truncated."""
    # MAVLink 2 keeps at least one payload byte.
    payload = payload.rstrip(b"\0") or b"\0"
    number = layout.id
    body = _HEAD.pack(len(payload), 0, 0, seq, system, component, number & 0xFFFF, number >> 16)
    body += payload
    return _STX + body + checksum(body, layout.crc_extra)


def _make_packing(layout: Layout) -> Packing:
    """Return the Struct of a payload and the default value of each field.

    Text and byte arrays are packed as one bytes object.
    """
    code, blanks = "<", []
    for field in layout.fields.values():
        as_bytes = field.type == "char" or (field.code == "B" and field.count > 0)
        code += f"{field.length}s" if as_bytes else field.code * max(field.count, 1)
        array = bytes(field.count) if as_bytes else (0,) * field.count
        blanks.append((field.name, b"" if field.type == "char" else array if field.count else 0))
    _packings[layout.id] = struct.Struct(code), tuple(blanks)
    return _packings[layout.id]
