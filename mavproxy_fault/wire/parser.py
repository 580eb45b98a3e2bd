"""Parser: bytes of a stream or of datagrams to frames, losing none of them.

Every byte comes out exactly once and in order, in a `Frame` (known id, right CRC) or in `Junk`.
After a wrong CRC the search goes on one byte later, so a broken frame never swallows the next one.

The CRC of a message the dialect does not know cannot be checked in full, since its CRC extra is
unknown. But the extra is one byte, so that only 256 of the 65,536 CRCs are possible: the others
show that the bytes are no frame, and those 256 pass as a frame of unknown content, unless a
verified frame begins inside.
"""

import re
from dataclasses import dataclass
from typing import Literal

from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.wire.dialect import Layout, find_layout
from mavproxy_fault.wire.frame import (
    HEADER_V1,
    HEADER_V2,
    SIGNATURE_LENGTH,
    SIGNED,
    STX_V1,
    STX_V2,
    Frame,
)

CRC_LENGTH = 2
NO_FRAME = (-1, -1)
START_BYTES = re.compile(b"[%c%c]" % (STX_V1, STX_V2))
CRC_TABLE_ENTRIES = frozenset(
    mcrf4xx(bytes((last,)), 0) for last in range(256)
)  # the CRC's table of bytes
JunkKind = Literal["foreign", "crc", "unknown"]


@dataclass(frozen=True, slots=True)
class Junk:
    """Bytes that are no verified frame.

    "unknown" is one whole frame of a message or flag the dialect does not know, "crc" holds at
    least one frame of a known message with a wrong CRC, "foreign" is anything else.
    """

    raw: bytes
    kind: JunkKind


@dataclass(slots=True)
class ParserCounters:
    """What a parser has seen; `crc_errors` counts places that looked like a known message."""

    bytes: int = 0
    frames: int = 0
    unknown: int = 0
    crc_errors: int = 0
    junk_bytes: int = 0

    def add(self, other: "ParserCounters") -> None:
        """Add another parser's counts to these."""
        self.bytes += other.bytes
        self.frames += other.frames
        self.unknown += other.unknown
        self.crc_errors += other.crc_errors
        self.junk_bytes += other.junk_bytes


class Parser:
    """The state of one stream; datagrams leave none behind."""

    def __init__(self) -> None:
        self.counters = ParserCounters()
        self._incomplete = b""
        self._layouts: dict[int, Layout | None] = {}
        self._frame_ahead = NO_FRAME  # a verified frame that lies ahead

    @property
    def incomplete(self) -> int:
        """Bytes of an incomplete frame that wait for more of the stream."""
        return len(self._incomplete)

    def push(self, data: bytes, *, datagram: bool = False) -> list[Frame | Junk]:
        """What the bytes complete; of a datagram, everything."""
        self.counters.bytes += len(data)
        if self._incomplete:
            data = self._incomplete + data
            self._incomplete = b""
        return self._parse(data, final=datagram)

    @property
    def contains_frame(self) -> bool:
        """Whether a verified frame lies inside of what waits for more of the stream."""
        return _find_frame_inside(self._incomplete, 1, len(self._incomplete)) is not None

    def release(self) -> list[Frame | Junk]:
        """The stream has ended: what is incomplete is parsed as far as it goes."""
        data, self._incomplete = self._incomplete, b""
        return self._parse(data, final=True)

    def resync(self) -> list[Frame | Junk]:
        """Take the first byte of what is incomplete for no beginning; what follows may be one."""
        data, self._incomplete = self._incomplete, b""
        return self._parse(data, final=False, at=1)

    def _parse(self, data: bytes, *, final: bool, at: int = 0) -> list[Frame | Junk]:
        found: list[Frame | Junk] = []
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
            # Wait for the rest from here on; of a datagram there is no rest.
            if item is None and not final:
                break
            # No frame: the next start byte may lie inside of what looked like one.
            if item is None or item is False:
                at += 1
                continue
            if at > junk_from:
                kind: JunkKind = "crc" if counters.crc_errors > crc_errors else "foreign"
                found.append(self._junk(data[junk_from:at], kind))
            found.append(item)
            crc_errors = counters.crc_errors
            at += len(item.raw)
            junk_from = at
        if at > junk_from:
            kind = "crc" if counters.crc_errors > crc_errors else "foreign"
            found.append(self._junk(data[junk_from:at], kind))
        # Never more than one frame: what is longer has been decided above.
        self._incomplete = data[at:]
        return found

    def _junk(self, raw: bytes, kind: JunkKind) -> Junk:
        self.counters.junk_bytes += len(raw)
        return Junk(raw, kind)

    def _candidate(self, data: bytes, at: int) -> Frame | Junk | Literal[False] | None:
        """What begins at a start byte; None if it is incomplete, False if it is no frame."""
        place = frame_span(data, at)
        if place is None or at + place[0] > len(data):
            return None
        length, number, checked = place
        # A parser sees few messages: their layouts are looked up once, unknown ones too.
        if number in self._layouts:
            known = self._layouts[number]
        else:
            known = self._layouts[number] = find_layout(number)
        crc = data[at + checked] | data[at + checked + 1] << 8
        body = data[at + 1 : at + checked]
        if known is None:
            if not _crc_is_possible(body, crc) or self._contains_frame(data, at, at + length):
                return False
            self.counters.unknown += 1
            return Junk(data[at : at + length], "unknown")
        if mcrf4xx(body + bytes((known.crc_extra,))) != crc:
            self.counters.crc_errors += 1
            return False
        raw = data[at : at + length]
        # MAVLink: a receiver must not read frames with flags it does not know.
        if raw[0] == STX_V2 and raw[2] & ~SIGNED:
            self.counters.unknown += 1
            return Junk(raw, "unknown")
        self.counters.frames += 1
        return Frame(raw, known)

    def _contains_frame(self, data: bytes, at: int, end: int) -> bool:
        """Whether a verified frame lies wholly inside of what begins here."""
        # One that was found already: bytes may be made so that each of them seems to begin a frame
        # around it, and to look for it anew would cost time quadratic in their number.
        if at < self._frame_ahead[0] and self._frame_ahead[1] <= end:
            return True
        inside = _find_frame_inside(data, at + 1, end)
        self._frame_ahead = inside or self._frame_ahead
        return inside is not None


def frame_span(data: bytes, at: int) -> tuple[int, int, int] | None:
    """Length, message id and offset of the CRC of a frame by its header; None if that is cut."""
    if data[at] == STX_V2:
        if at + HEADER_V2 > len(data):
            return None
        checked = HEADER_V2 + data[at + 1]
        length = checked + CRC_LENGTH + (SIGNATURE_LENGTH if data[at + 2] & SIGNED else 0)
        return length, int.from_bytes(data[at + 7 : at + HEADER_V2], "little"), checked
    if at + HEADER_V1 > len(data):
        return None
    checked = HEADER_V1 + data[at + 1]
    return checked + CRC_LENGTH, data[at + 5], checked


def begins_with_frame(data: bytes) -> bool:
    """Whether verified bytes of a known message stand at the beginning."""
    return bool(data) and isinstance(next(iter(Parser().push(data, datagram=True))), Frame)


def _crc_is_possible(body: bytes, crc: int) -> bool:
    """Whether some CRC extra gives this CRC."""
    # The last step takes in the extra: it shifts the register and adds one entry of the table.
    return crc ^ (mcrf4xx(body) >> 8) in CRC_TABLE_ENTRIES


def _find_frame_inside(data: bytes, start: int, end: int) -> tuple[int, int] | None:
    """Where the first verified frame begins and ends that lies wholly inside a stretch."""
    # A message that is unknown and by chance passes must not hide a known one.
    for begin in START_BYTES.finditer(data, start, max(start, end - HEADER_V1 - CRC_LENGTH + 1)):
        at = begin.start()
        place = frame_span(data, at)
        if place is None or at + place[0] > end:
            continue
        known = find_layout(place[1])
        checked = at + place[2]
        if known is not None and mcrf4xx(
            data[at + 1 : checked] + bytes((known.crc_extra,))
        ) == int.from_bytes(data[checked : checked + CRC_LENGTH], "little"):
            return at, at + place[0]
    return None
