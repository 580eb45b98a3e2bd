"""Where the code ranges of a RINEX 2, 3 or 4 observation file stand, and how they are changed.

Every code of a satellite is one range to faults: a bias is added to all of them, phase and Doppler
stay. A lost satellite's codes are blank, which RINEX knows as "not observed".

References
----------
IGS/RTCM, RINEX 3.05, tables A2, A3; W. Gurtner, RINEX 2.11, tables A1, A2.
"""

import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from mavproxy_fault.rinex.range_epoch import RangeEpoch
from mavproxy_fault.rinex.rinex_text import types_2, types_3

GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
FIELD, VALUE = 16, 14  # F14.3, loss of lock, signal strength
NAME = 3  # the satellite's name begins a line of RINEX 3
PER_LINE_2 = 5  # observations in a line of RINEX 2
HEAD_NAMES_2, NAMES_AT_2 = 12, 32
CENTURY_2 = 80  # years from here on are of the twentieth

Place = tuple[int, int]  # line, column


class FileEpoch(NamedTuple):
    """Stamp in us since the start of GPS time, and where the codes of each satellite stand."""

    t_us: int
    codes: dict[str, list[Place]]


def file_epochs(lines: Sequence[str], version: float, start: int) -> Iterator[FileEpoch]:
    """The epochs behind a header that ends before line `start`."""
    header = lines[:start]
    return _epochs_3(lines, start, header) if version >= 3.0 else _epochs_2(lines, start, header)


def written(lines: list[str], epoch: FileEpoch, faulted: RangeEpoch) -> None:
    """Write what faults made of an epoch into its lines, in place."""
    for name, places in epoch.codes.items():
        for at, column in places:
            line = lines[at].ljust(column + FIELD)
            value = line[column : column + VALUE]
            if name in faulted.lost:
                value = " " * VALUE
            elif name in faulted.added_m:
                value = _shifted(value, faulted.added_m[name])
            lines[at] = (line[:column] + value + line[column + VALUE :]).rstrip()


def _shifted(value: str, metres: float) -> str:
    """A field with metres added; one that is blank or zero holds no range."""
    try:
        range_m = float(value)
    except ValueError:
        return value
    if range_m == 0.0 or not math.isfinite(range_m):
        return value
    return f"{range_m + metres:{VALUE}.3f}"


def _stamp_us(year: int, words: Sequence[str]) -> int:
    """Of month, day, hour, minute and second in GPS time."""
    month, day, hour, minute = (int(word) for word in words[:4])
    since = datetime(year, month, day, hour, minute, tzinfo=UTC) - GPS_ZERO
    return since // timedelta(microseconds=1) + round(float(words[4]) * 1e6)


def _epochs_3(lines: Sequence[str], at: int, header: Sequence[str]) -> Iterator[FileEpoch]:
    columns = _columns_3(header)
    while at < len(lines):
        head, at = lines[at], at + 1
        if not head.startswith(">") or head[31:32] > "1":
            continue
        try:
            t_us = _stamp_us(int(head[2:6]), head[6:29].split())
        except (ValueError, IndexError):
            continue
        codes: dict[str, list[Place]] = {}
        while at < len(lines) and not lines[at].startswith(">"):
            line = lines[at]
            name = line[:NAME].replace(" ", "0")
            codes[name] = [(at, column) for column in columns.get(line[:1], ())]
            at += 1
        yield FileEpoch(t_us, codes)


def _columns_3(header: Sequence[str]) -> dict[str, list[int]]:
    """By system where its codes begin in a line."""
    return {
        system: [NAME + FIELD * i for i, name in enumerate(names) if name.startswith("C")]
        for system, names in types_3(header).items()
    }


def _epochs_2(lines: Sequence[str], at: int, header: Sequence[str]) -> Iterator[FileEpoch]:
    types = types_2(header)
    places = [divmod(i, PER_LINE_2) for i, name in enumerate(types) if name[0] in "CP"]
    per_satellite = -(-len(types) // PER_LINE_2)
    while at < len(lines):
        head, at = lines[at], at + 1
        try:
            year = int(head[1:3])
            t_us = _stamp_us(year + (1900 if year >= CENTURY_2 else 2000), head[3:26].split())
            flag, count = int(head[26:29]), int(head[29:32])
        except (ValueError, IndexError):
            continue
        names = head[NAMES_AT_2:].rstrip()
        for _ in range((count - 1) // HEAD_NAMES_2):
            names = names.ljust(3 * HEAD_NAMES_2) + lines[at][NAMES_AT_2:].rstrip()
            at += 1
        codes: dict[str, list[Place]] = {}
        for i in range(count if flag <= 1 else 0):
            name = names[3 * i : 3 * i + 3].replace(" ", "0")
            name = "G" + name[1:] if name[:1] == "0" else name  # GPS's letter may be left out
            codes[name] = [
                (at + row, FIELD * column) for row, column in places if at + row < len(lines)
            ]
            at += per_satellite
        yield FileEpoch(t_us, codes)
