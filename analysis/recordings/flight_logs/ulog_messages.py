"""Find the messages of a ULog, block by block, whatever bytes are wrong or missing [1]_.

A message counts only where another one or the end of the log follows it. Where none does, the next
two that follow each other are sought, byte by byte.

.. [1] PX4 User Guide, ULog File Format.
"""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from analysis.recordings.flight_logs.logged_rows import BLOCK_BYTES, BlockRows, gather_rows

MAGIC = b"ULog\x01\x12\x35"
HEADER_BYTES, HEAD = 16, 3  # of the file, and of a message
LONGEST = HEAD + 0xFFFF
KINDS = frozenset(b"ABCDFILMOPQRS")
NUMBERS = {
    "int8_t": "<i1", "uint8_t": "<u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4",
    "uint32_t": "<u4", "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8",
    "bool": "<u1", "char": "S1",
}  # fmt: skip
FIELD = re.compile(r"(\w+)(?:\[(\d+)\])? (\w+)$", re.ASCII)
LENGTHS = {"B": 40, "S": 8, "R": 2, "O": 2, "L": 9, "C": 11, "A": 4, "D": 2}  # payload, at least
SHORTEST = {ord(kind): length for kind, length in LENGTHS.items()}
# What the payload of a message begins with, or all of it: no message is found by chance.
SOUND = {
    ord(kind): re.compile(begin, re.DOTALL)
    for kind, begin in {
        "A": rb"...\w+$", "B": rb".{40}$", "C": rb"[0-7].{10}", "D": rb"..",
        "F": rb"[\w/]+:[\w\[\]; ]+$", "I": rb".[\w\[\]]+ \w", "L": rb"[0-7].{8}", "M": rb"..\w",
        "O": rb"..$", "P": rb".(int32_t|float) \w", "Q": rb"..(int32_t|float) \w", "R": rb"..$",
        "S": rb"\x2f\x73\x13\x20\x25\x0c\xbb\x12$",
    }.items()
}  # fmt: skip
APPENDED, OFFSETS = 1, struct.Struct("<3Q")  # bit of the flags, and where data were appended


@dataclass(slots=True)
class ULogTopic:
    """A topic, whose shortest rows have `least` bytes."""

    name: str
    instance: int
    dtype: np.dtype[np.void]
    least: int


@dataclass(slots=True)
class ULogMessages:
    """What a walk over a log collects."""

    # Fields (type, length, name) by format.
    formats: dict[str, list[tuple[str, int, str]]] = field(default_factory=dict)
    topics: dict[int, ULogTopic] = field(default_factory=dict)  # by message id
    # Offset, kind and payload of all messages that are not of topics, in order.
    others: list[tuple[int, str, bytes]] = field(default_factory=list)
    # Offsets at which data were appended, behind an unfinished message.
    appended: list[int] = field(default_factory=list)
    begin_us: int = 0  # when the log began, by its header
    skipped_bytes: int = 0
    cut: bool = False  # whether the file ends within a message


def walk_messages(
    path: Path, size: int, found: ULogMessages, progress: Callable[[float], None]
) -> Iterator[BlockRows]:
    """Collect the messages in the first `size` bytes of a log; yields the topics' rows of each
    block by name and instance."""
    with path.open("rb") as file:
        found.begin_us = int.from_bytes(file.read(HEADER_BYTES)[8:], "little")
        data, at = b"", HEADER_BYTES
        while at + len(data) < size:
            data += file.read(min(BLOCK_BYTES, size - at - len(data)))
            last = at + len(data) >= size
            end, rows = _read_block(found, data, at, last)
            yield rows
            data, at = data[end:], at + end
            progress(min((at + len(data)) / size, 1.0))


def _read_block(found: ULogMessages, data: bytes, at: int, last: bool) -> tuple[int, BlockRows]:
    """Read the messages in a block that begins at `at` in the file; returns where they end, and
    rows."""
    places: dict[int, list[int]] = {}
    begin, stop = 0, len(data) if last else len(data) - 2 * LONGEST
    while begin < stop:
        end = _end_of(found, data, begin)
        if end == 0 or any(begin < offset - at < end for offset in found.appended):
            after = _next_message(found, data, begin, at)
            complete = after < len(data) or len(data) - begin >= HEAD + 0xFFFF
            found.cut = last and not complete and _is_begun(data, begin)
            found.skipped_bytes += 0 if found.cut else after - begin
            begin = after
            continue
        if data[begin + 2] == ord("D"):
            places.setdefault(data[begin + 3] | data[begin + 4] << 8, []).append(begin)
        else:
            _define(found, at + begin, chr(data[begin + 2]), data[begin + HEAD : end])
        begin = end
    raw, head, rows = np.frombuffer(data, np.uint8), HEAD + 2, []
    for topic, starts in ((found.topics[n], s) for n, s in places.items() if n in found.topics):
        some = gather_rows(raw, at - head, np.array(starts) + head, topic.dtype, topic.least)
        rows.append(((topic.name, topic.instance), some))
    return begin, rows


def _end_of(found: ULogMessages, data: bytes, begin: int) -> int:
    """Where a message that begins at `begin` ends; 0 if there is none."""
    size = len(data)
    if begin + HEAD > size:
        return 0
    kind, end = data[begin + 2], begin + HEAD + (data[begin] | data[begin + 1] << 8)
    if kind not in KINDS or end > size or end - begin - HEAD < SHORTEST.get(kind, 3):
        return 0
    if kind == ord("D"):
        topic = found.topics.get(data[begin + 3] | data[begin + 4] << 8)
        if topic is not None:
            fits = topic.least <= end - begin - HEAD - 2 <= topic.dtype.itemsize - 8
            return end if fits else 0
    # What follows must be a message, too.
    return end if size - end < HEAD or data[end + 2] in KINDS else 0


def _next_message(found: ULogMessages, data: bytes, begin: int, at: int) -> int:
    """Where the next message begins that is followed by another one; the end without any."""
    size = len(data)
    for offset in found.appended:
        if begin < offset - at <= begin + LONGEST:
            return min(offset - at, size)
    for start in range(begin + 1, size - HEAD):
        if data[start + 2] in KINDS:
            end = _end_of(found, data, start)
            sound = end and SOUND[data[start + 2]].match(data, start + HEAD, end)
            if sound and (end == size or _end_of(found, data, end)):
                return start
    return size


def _is_begun(data: bytes, begin: int) -> bool:
    """Whether the block ends within the message at `begin`."""
    return begin + HEAD > len(data) or data[begin + 2] in KINDS


def _define(found: ULogMessages, at: int, kind: str, payload: bytes) -> None:
    """Note a message; formats, topics and appended data define how the next ones are read."""
    if kind == "F":
        name, _, fields = payload.decode("latin-1").partition(":")
        every = [FIELD.match(part.strip()) for part in fields.split(";") if part.strip()]
        # A format with a damaged field is none.
        if all(every):
            found.formats[name] = [(m[1], int(m[2] or 0), m[3]) for m in every if m]
    elif kind == "A":
        instance, number, name = (
            payload[0],
            payload[1] | payload[2] << 8,
            payload[3:].decode("latin-1"),
        )
        try:
            dtype, least = _row_type(found.formats, name)
            found.topics[number] = ULogTopic(name, instance, dtype, least)
        except (KeyError, ValueError, RecursionError):  # a damaged format
            return
    elif kind == "B" and payload[8] & APPENDED:
        found.appended = [offset for offset in OFFSETS.unpack_from(payload, 16) if offset]
    else:
        found.others.append((at, kind, payload))


def _row_type(
    formats: dict[str, list[tuple[str, int, str]]], name: str
) -> tuple[np.dtype[np.void], int]:
    """The type of a topic's rows, and its least bytes: the logger omits padding at the end."""
    names, kinds, offsets, at = ["at"], ["<i8"], [0], 8
    for key, kind in _flat_fields(formats, name, ""):
        if "_padding" not in key:
            names.append(key if key not in names else f"{key}_")
            kinds.append(kind)
            offsets.append(at)
        at += np.dtype(kind).itemsize
    if at > LONGEST:
        raise ValueError(name)
    form: Any = {"names": names, "formats": kinds, "offsets": offsets, "itemsize": at}
    return np.dtype(form), offsets[-1] + np.dtype(kinds[-1]).itemsize - 8


def _flat_fields(
    formats: dict[str, list[tuple[str, int, str]]], name: str, prefix: str
) -> Iterator[tuple[str, str]]:
    """Name and type of each number in a format, arrays and structures by their elements."""
    for kind, length, field_name in formats[name]:
        if kind == "char" and length:
            yield prefix + field_name, f"S{length}"
            continue
        for i in range(length or 1):
            key = f"{prefix}{field_name}[{i}]" if length else prefix + field_name
            if kind in NUMBERS:
                yield key, NUMBERS[kind]
            else:
                yield from _flat_fields(formats, kind, f"{key}.")
