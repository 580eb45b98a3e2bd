"""Lossless parser from a byte stream or datagrams to MAVLink frames.

Every byte comes out exactly once and in order, in a `Frame` (known id, correct CRC) or in `Junk`.
After a wrong CRC the search resumes one byte later, so a broken frame never swallows the next one.

The CRC of a message outside the dialect cannot be fully checked, because its CRC extra is unknown.
The extra is one byte, so only 256 of the 65,536 CRC values are possible. Any other value rejects
the bytes; one of the 256 accepts them as a frame of unknown content, unless they contain a
verified frame.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.wire.dialect import Layout, find_layout
from mavproxy_fault.wire.frame import (
    CRC_LENGTH,
    HEADER_V1,
    STX_V1,
    STX_V2,
    Frame,
    checksum,
    has_unknown_flags,
    whole_frame,
)

MAX_UNKNOWN_IDS = 256  # chosen: more than a dialect has; bounds the memory against random ids
NO_FRAME = (-1, -1)
START_BYTES = re.compile(b"[%c%c]" % (STX_V1, STX_V2))
CRC_TABLE_ENTRIES = {  # table of the byte-wise CRC, to index
    mcrf4xx(bytes((last,)), 0): last for last in range(256)
}
JunkKind = Literal["foreign", "crc", "unknown"]


@dataclass(frozen=True, slots=True)
class Junk:
    """Bytes that are not a verified frame.

    "unknown" is one complete frame with a message id or flag outside the dialect, "crc" contains
    at least one frame of a known message with a wrong CRC, "foreign" is anything else.
    """

    raw: bytes
    kind: JunkKind

    def frame(self) -> Frame | None:
        """Return a frame of an unknown message, whose header can be read; None for other bytes."""
        if self.kind != "unknown":
            return None
        head, number, _ = whole_frame(self.raw, 0, len(self.raw))
        checked = head + self.raw[1]
        extra = _crc_extra_of(self.raw[1:checked], self.raw[checked : checked + CRC_LENGTH])
        assert extra is not None
        return Frame(self.raw, Layout(f"UNKNOWN_{number}", number, extra, "", {}, 0, 0))


@dataclass(slots=True)
class ParserCounters:
    """Totals of parsers that share them; `crc_errors` are positions that looked like a message."""

    bytes: int = 0
    frames: int = 0
    unknown: int = 0
    crc_errors: int = 0
    junk_bytes: int = 0
    unknown_ids: dict[int, int] = field(default_factory=dict)  # frames by message id

    def note_unknown(self, number: int) -> None:
        """Count a frame that cannot be read."""
        self.unknown += 1
        if number in self.unknown_ids or len(self.unknown_ids) < MAX_UNKNOWN_IDS:
            self.unknown_ids[number] = self.unknown_ids.get(number, 0) + 1


class Parser:
    """The parser of one stream; it keeps no state between datagrams, and adds to `counters`."""

    def __init__(self, counters: ParserCounters | None = None) -> None:
        self.counters = counters or ParserCounters()
        self._incomplete = b""
        self._layouts: dict[int, Layout | None] = {}
        self._frame_ahead = NO_FRAME  # start and end of a verified frame further on

    @property
    def incomplete(self) -> int:
        """Number of buffered bytes of an incomplete frame."""
        return len(self._incomplete)

    def push(self, data: bytes, *, datagram: bool = False) -> list[Frame | Junk]:
        """Parse further bytes; return completed items, for a datagram everything."""
        self.counters.bytes += len(data)
        if self._incomplete:
            data = self._incomplete + data
            self._incomplete = b""
        return self._parse(data, final=datagram)

    def take_incomplete(self) -> bytes:
        """Return and forget the buffered bytes, which are pushed again."""
        data, self._incomplete = self._incomplete, b""
        self.counters.bytes -= len(data)
        return data

    @property
    def contains_frame(self) -> bool:
        """Whether the incomplete bytes contain a verified frame."""
        return _find_frame_inside(self._incomplete, 1, len(self._incomplete)) is not None

    def release(self) -> list[Frame | Junk]:
        """End the stream: parse the incomplete bytes as they are."""
        data, self._incomplete = self._incomplete, b""
        return self._parse(data, final=True)

    def resync(self) -> list[Frame | Junk]:
        """Reject the first incomplete byte as a frame start and search again behind it."""
        data, self._incomplete = self._incomplete, b""
        return self._parse(data, final=False, at=1)

    def _parse(self, data: bytes, *, final: bool, at: int = 0) -> list[Frame | Junk]:
        items: list[Frame | Junk] = []
        self._frame_ahead = NO_FRAME
        counters = self.counters
        junk_from = 0
        end = len(data)
        crc_errors = counters.crc_errors
        while at < end:
            start = data[at]
            if start != STX_V2 and start != STX_V1:
                at += 1
                continue
            item = self._candidate(data, at)
            # A stream may still deliver the rest; a datagram cannot.
            if item is None and not final:
                break
            # Not a frame: the next start byte may lie inside the rejected bytes.
            if item is None or item is False:
                at += 1
                continue
            if at > junk_from:
                kind: JunkKind = "crc" if counters.crc_errors > crc_errors else "foreign"
                items.append(self._junk(data[junk_from:at], kind))
            items.append(item)
            crc_errors = counters.crc_errors
            at += len(item.raw)
            junk_from = at
        if at > junk_from:
            kind = "crc" if counters.crc_errors > crc_errors else "foreign"
            items.append(self._junk(data[junk_from:at], kind))
        # At most one frame: anything longer has been decided above.
        self._incomplete = data[at:]
        return items

    def _junk(self, raw: bytes, kind: JunkKind) -> Junk:
        self.counters.junk_bytes += len(raw)
        return Junk(raw, kind)

    def _candidate(self, data: bytes, at: int) -> Frame | Junk | Literal[False] | None:
        """Parse the item at a start byte; None if it is incomplete, False if it is not a frame."""
        head, number, end = whole_frame(data, at, len(data))
        if head == 0:
            return None
        checked = at + head + data[at + 1]
        # A stream has few message ids: cache their layouts, including unknown ones.
        if number in self._layouts:
            known = self._layouts[number]
        else:
            known = self._layouts[number] = find_layout(number)
        crc, body = data[checked : checked + CRC_LENGTH], data[at + 1 : checked]
        if known is None:
            if _crc_extra_of(body, crc) is None or self._contains_frame(data, at, end):
                return False
            self.counters.note_unknown(number)
            return Junk(data[at:end], "unknown")
        if checksum(body, known.crc_extra) != crc:
            self.counters.crc_errors += 1
            return False
        raw = data[at:end]
        # MAVLink: a receiver must not read frames with unknown incompat flags.
        if has_unknown_flags(raw, 0):
            self.counters.note_unknown(number)
            return Junk(raw, "unknown")
        self.counters.frames += 1
        return Frame(raw, known)

    def _contains_frame(self, data: bytes, at: int, end: int) -> bool:
        """Whether a verified frame lies entirely within [at, end)."""
        # Reuse the last one found: in crafted input every byte may seem to start a frame around it,
        # and searching again each time would take quadratic time.
        if at < self._frame_ahead[0] and self._frame_ahead[1] <= end:
            return True
        inside = _find_frame_inside(data, at + 1, end)
        self._frame_ahead = inside or self._frame_ahead
        return inside is not None


def walk_frames(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield start, end and message id of the complete frames that bytes begin with, unverified."""
    at = 0
    while at < len(data):
        head, number, end = whole_frame(data, at, len(data))
        if head == 0:
            return
        yield at, end, number
        at = end


def begins_with_frame(data: bytes) -> bool:
    """Whether the bytes begin with a verified frame of a known message."""
    return bool(data) and isinstance(next(iter(Parser().push(data, datagram=True))), Frame)


def _crc_extra_of(body: bytes, crc: bytes) -> int | None:
    """Return the CRC extra that gives this CRC; None if there is none."""
    # The last step processes the extra: shift the register and XOR one table entry.
    before = mcrf4xx(body)
    index = CRC_TABLE_ENTRIES.get(int.from_bytes(crc, "little") ^ before >> 8)
    return None if index is None else index ^ before & 0xFF


def _find_frame_inside(data: bytes, start: int, end: int) -> tuple[int, int] | None:
    """Find the first verified frame entirely within [start, end); return its start and end."""
    # An unknown message whose CRC passes by chance must not hide a known one.
    for begin in START_BYTES.finditer(data, start, max(start, end - HEADER_V1 - CRC_LENGTH + 1)):
        at = begin.start()
        head, number, stop = whole_frame(data, at, end)
        if head == 0:
            continue
        known = find_layout(number)
        checked = at + head + data[at + 1]
        sent = data[checked : checked + CRC_LENGTH]
        if known is not None and checksum(data[at + 1 : checked], known.crc_extra) == sent:
            return at, stop
    return None
