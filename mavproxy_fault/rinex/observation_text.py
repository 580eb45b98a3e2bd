"""Finds the observations in the lines of a RINEX 2, 3 or 4 observation file.

A range fault changes all codes of a satellite alike, but not its phase and Doppler. A spoofed
signal has another phase and Doppler too.

References
----------
IGS/RTCM, RINEX 3.05, tables A2, A3; W. Gurtner, RINEX 2.11, tables A1, A2.
"""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from mavproxy_fault.rinex.rinex_text import types_2, types_3
from mavproxy_fault.rinex.signal_fields import FIELD, ObservationField

GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
NAME = 3  # a line of RINEX 3 begins with the satellite's name
PER_LINE_2 = 5  # observations in a line of RINEX 2
HEAD_NAMES_2, NAMES_AT_2 = 12, 32
CENTURY_2 = 80  # years from here on are in the twentieth century


class FileEpoch(NamedTuple):
    """Timestamp [us] since the start of GPS time, and the observations of each satellite."""

    t_us: int
    observations: dict[str, list[ObservationField]]


def file_epochs(lines: Sequence[str], version: float, start: int) -> Iterator[FileEpoch]:
    """Yield the epochs after a header that ends before line `start`."""
    header = lines[:start]
    return _epochs_3(lines, start, header) if version >= 3.0 else _epochs_2(lines, start, header)


def _stamp_us(year: int, words: Sequence[str]) -> int:
    """Convert month, day, hour, minute and second in GPS time to a timestamp [us]."""
    month, day, hour, minute = (int(word) for word in words[:4])
    since = datetime(year, month, day, hour, minute, tzinfo=UTC) - GPS_ZERO
    return since // timedelta(microseconds=1) + round(float(words[4]) * 1e6)


def _epochs_3(lines: Sequence[str], at: int, header: Sequence[str]) -> Iterator[FileEpoch]:
    types = types_3(header)
    while at < len(lines):
        head, at = lines[at], at + 1
        if not head.startswith(">") or head[31:32] > "1":
            continue
        try:
            t_us = _stamp_us(int(head[2:6]), head[6:29].split())
        except (ValueError, IndexError):
            continue
        found: dict[str, list[ObservationField]] = {}
        while at < len(lines) and not lines[at].startswith(">"):
            line = lines[at]
            name = line[:NAME].replace(" ", "0")
            found[name] = [
                ObservationField(kind, at, NAME + FIELD * i)
                for i, kind in enumerate(types.get(line[:1], ()))
            ]
            at += 1
        yield FileEpoch(t_us, found)


def _epochs_2(lines: Sequence[str], at: int, header: Sequence[str]) -> Iterator[FileEpoch]:
    types = types_2(header)
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
        found: dict[str, list[ObservationField]] = {}
        for k in range(count if flag <= 1 else 0):
            name = names[3 * k : 3 * k + 3].replace(" ", "0")
            name = "G" + name[1:] if name[:1] == "0" else name  # the letter of GPS is optional
            found[name] = [
                ObservationField(kind, at + i // PER_LINE_2, FIELD * (i % PER_LINE_2))
                for i, kind in enumerate(types)
                if at + i // PER_LINE_2 < len(lines)
            ]
            at += per_satellite
        yield FileEpoch(t_us, found)
