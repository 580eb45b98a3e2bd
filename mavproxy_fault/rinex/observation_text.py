"""Finds the epochs and observations in the lines of a RINEX 2, 3 or 4 observation file.

The reader is a state machine: a header record holds from where it stands, be it in the header, in
an event (flags 2 to 5) or between epochs, as in files that were joined. A damaged epoch line costs
its epoch only, and so do too few lines; a truncated file ends with its last complete epoch.

References
----------
IGS/RTCM, RINEX 3.05, tables A2, A3; W. Gurtner, RINEX 2.11, tables A1, A2.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from mavproxy_fault.rinex.gps_clock import WEEK_S, time_of_words
from mavproxy_fault.rinex.observation_header import (
    PER_LINE_2,
    ObservationField,
    ObservationHeader,
)

HEAD_NAMES_2, NAMES_2 = 12, slice(32, 68)  # satellites in an epoch line of RINEX 2
OBSERVED, CYCLE_SLIPS = "01", "6"  # flags of epochs, and of records like those of an epoch
# The numbers of observations have three decimals, the seconds of an epoch seven.
HEAD_2 = re.compile(
    r"[ \d]{3}(?: [ \d]\d){4}[ \d]{3}\.[\d ]{7}  [0-6][ \d]{3}| {26}  [2-5][ \d]{3}"
)
HEAD_3 = ">"


class FileEpoch(NamedTuple):
    """GPS week and seconds of week; the first line of each satellite's observations; the header
    records that hold."""

    week: int
    tow_s: float
    rows: dict[str, int]
    header: ObservationHeader

    @property
    def t_us(self) -> int:
        """Timestamp [us] since the start of GPS time."""
        return round((self.week * WEEK_S + self.tow_s) * 1e6)

    def fields(self, satellite: str) -> list[ObservationField]:
        """The fields of a satellite's observations."""
        return self.header.fields(satellite, self.rows[satellite])


class _EpochHead(NamedTuple):
    """Flag of an epoch line, how many satellites or records follow, and the line after it; names
    of satellites (RINEX 2) and time, where readable."""

    flag: str
    follow: int
    at: int
    names: list[str]
    time: tuple[int, float] | None


def file_epochs(lines: Sequence[str]) -> Iterator[FileEpoch]:
    """Yield the epochs of a file in their order."""
    header, at = ObservationHeader(), 0
    while at < len(lines):
        if not _is_head(lines[at], header):
            end = at + 1
            while end < len(lines) and not _is_head(lines[end], header):
                end += 1
                if lines[end - 1][60:].startswith("END OF HEADER"):
                    break
            header, at = header.with_records(lines[at:end]), end
            continue
        head = _epoch_head(lines, at, header)
        at = head.at
        if head.flag not in OBSERVED + CYCLE_SLIPS:
            end = _end_of_block(lines, at, head.follow, header)
            header, at = header.with_records(lines[at:end]), end
            continue
        per_satellite = _lines_per_satellite(header)
        end = _end_of_block(lines, at, head.follow * per_satellite, header)
        complete = end - at == head.follow * per_satellite
        if header.version >= 3.0:
            names = [line[:3].replace(" ", "0") for line in lines[at:end]]
            # A line too few costs no epoch, unless the file ends with it.
            complete = complete or end < len(lines)
        else:
            names = head.names
            complete = complete and all(names)
        if head.time is not None and head.flag in OBSERVED and complete:
            rows: dict[str, int] = {}
            for k, name in enumerate(names):
                if name[1:].isdigit():
                    rows.setdefault(name, at + k * per_satellite)
            yield FileEpoch(*head.time, rows, header)
        at = end


def _is_head(line: str, header: ObservationHeader) -> bool:
    if header.version >= 3.0:
        return line.startswith(HEAD_3)
    return HEAD_2.match(line) is not None


def _lines_per_satellite(header: ObservationHeader) -> int:
    return -(-len(header.types.get("", ())) // PER_LINE_2) if header.version < 3.0 else 1


def _end_of_block(lines: Sequence[str], at: int, count: int, header: ObservationHeader) -> int:
    """The line after `count` lines, or the next epoch line before it."""
    end = min(at + count, len(lines))
    return next((i for i in range(at, end) if _is_head(lines[i], header)), end)


def _epoch_head(lines: Sequence[str], at: int, header: ObservationHeader) -> _EpochHead:
    line = lines[at]
    names: list[str] = []
    three = header.version >= 3.0
    flag, count_text, when = (
        (line[31:32], line[32:35], line[2:29]) if three else (line[28:29], line[29:32], line[:26])
    )
    at += 1
    try:
        time = time_of_words(when.split(), header.clock)
    except ValueError:
        time = None
    count = int(count_text) if count_text.strip().isdigit() else 0
    if not three and flag in OBSERVED + CYCLE_SLIPS:
        text = line[NAMES_2].ljust(3 * HEAD_NAMES_2)
        for _ in range((count - 1) // HEAD_NAMES_2):
            if at < len(lines) and not _is_head(lines[at], header):
                text += lines[at][NAMES_2].ljust(3 * HEAD_NAMES_2)
                at += 1
        names = [_name_2(text[3 * k : 3 * k + 3], header.system) for k in range(count)]
    return _EpochHead(flag, count, at, names, time)


def _name_2(text: str, system: str) -> str:
    """A satellite's name, "" if damaged; RINEX 2 may omit the letter of the file's system."""
    letter = text[:1].strip() or (system if system != "M" else "G")
    name = letter + text[1:].replace(" ", "0")
    return name if text[1:].strip().isdigit() else ""
