"""Logs of MAVLink frames: whole logs to columns, frame by frame, and written.

A tlog is a row of records, each the microseconds since 1970 (or on the vehicle's clock) as a
big-endian 64-bit integer and the bytes of one frame. Nothing in it can be trusted: bytes may be
missing or wrong anywhere, the last record is often cut short, logs are joined, clocks jump. Every
frame whose checksum is right is found all the same, and what was passed over is counted.

A file is mapped, not read: `read_columns` needs the memory of the columns it returns,
`read_blocks` that of one block, whatever the size of the file.
"""

import struct
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.crc import SLICES, slicing_tables
from mavproxy_fault.wire.dialect import Layout, message_layout, message_names
from mavproxy_fault.wire.frame import HEADER_V1, HEADER_V2, SIGNATURE_LENGTH, SIGNED, Frame
from mavproxy_fault.wire.written import written_bytes

if TYPE_CHECKING:  # numba is loaded when a log is read, not before
    from mavproxy_fault.wire.log_walk import LogFrames, LogMessages

Columns = dict[str, NDArray[np.void]]

BLOCK_FRAMES = 1 << 17
ORDERED_FRAMES = 1 << 15  # of `read_ordered`: fewer cost calls, more the processor's cache
CACHED_FRAMES = 1 << 14  # whose places and stamps stay in the processor's cache
END_BYTES = 1 << 16  # as much of a log's beginning or end as shows its first or last frame


@dataclass(frozen=True, slots=True)
class _Block:
    """Frames of a stretch of a log: a row per run of them (`walk.walk`), frames of each message.

    `end` is the place in the log behind the stretch.
    """

    runs: NDArray[np.int64]
    counts: NDArray[np.int64]
    junk_bytes: int
    end: int


@dataclass(frozen=True, slots=True)
class Log:
    """A log read.

    Attributes
    ----------
    columns : dict of structured arrays
        Per message `t_us` (the log's stamp), `system`, `component`, `seq` and the message's fields.
    frames : structured array
        Every frame in the log's order: `t_us`, `id`, `system`, `component`, `seq`,
        `message_layout`.
    junk_bytes : int
        Bytes that belong to no frame found: broken records, a cut tail, foreign bytes.
    size, end : int
        Bytes of the file as far as it was written, and of them those walked so far.
    """

    columns: Columns
    frames: NDArray[np.void]
    junk_bytes: int
    size: int
    end: int


FRAMES = np.dtype(
    [
        ("t_us", "<i8"),
        ("id", "<u4"),
        ("system", "u1"),
        ("component", "u1"),
        ("seq", "u1"),
        ("known", "?"),
    ]
)


@cache
def row_dtype(name: str) -> np.dtype[np.void]:
    """The type of a message's rows: packed, the fields in their order on the wire."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [
        ("t_us", "<i8"),
        ("system", "u1"),
        ("component", "u1"),
        ("seq", "u1"),
    ]
    # A message may have fields of these names: they get an underscore.
    taken = {"t_us", "system", "component", "seq"}
    for field in message_layout(name).fields.values():
        column = field.name + "_" if field.name in taken else field.name
        if field.type == "char":
            fields.append((column, f"S{max(field.count, 1)}"))
        elif field.count:
            fields.append((column, np.dtype("<" + field.code).str, (field.count,)))
        else:
            fields.append((column, np.dtype("<" + field.code).str))
    return np.dtype(fields)


@cache
def _messages() -> "LogMessages":
    """The dialect as the compiled walk takes it."""
    from mavproxy_fault.wire.log_walk import LogMessages

    layouts = [message_layout(name) for name in message_names()]
    # A table by message id: kernels look up faster in it than in a dictionary.
    slots = np.full(max(item.id for item in layouts) + 1, -1, np.int16)
    for slot, item in enumerate(layouts):
        slots[item.id] = slot
    extras = np.array([item.crc_extra for item in layouts], np.uint64)
    lengths = np.array([item.length for item in layouts], np.int64)
    tables = np.array(slicing_tables(), np.uint16).reshape(SLICES, 256)
    return LogMessages(slots, extras, lengths, tables)


def map_bytes(path: Path) -> NDArray[np.uint8]:
    """The bytes of a file, mapped.

    Raises
    ------
    ConfigError
        If the file is missing, not a file, or empty.
    """
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path}: not a file; give the path of a log")
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file; give the path of a log")
    size = written_bytes(path)
    if size == 0:
        raise ConfigError(f"{path}: the log is empty; nothing was recorded")
    # Pages come in as the walk needs them: a log may be larger than memory.
    return np.memmap(path, np.uint8, mode="r", shape=(size,))


def _blocks(data: NDArray[np.uint8], frames: int) -> Iterator[_Block]:
    """The frames of a log, so many at a time."""
    from mavproxy_fault.wire.log_walk import walk

    messages = _messages()
    runs = np.empty((frames, 2), np.int64)
    start = 0
    while start < len(data):
        counts = np.zeros(len(messages.lengths), np.int64)
        found, start, junk = walk(data, start, messages, runs, counts)
        yield _Block(runs[:found].copy(), counts, junk, start)


def _entire_log(data: NDArray[np.uint8]) -> _Block:
    """A log as one block."""
    blocks = list(_blocks(data, BLOCK_FRAMES))
    return _Block(
        np.concatenate([block.runs for block in blocks]),
        np.sum([block.counts for block in blocks], axis=0),
        sum(block.junk_bytes for block in blocks),
        blocks[-1].end,
    )


def _unroll_frames(data: NDArray[np.uint8], block: _Block) -> Iterator["LogFrames"]:
    """Start, stamp and slot of every frame, some at a time in arrays that are used again."""
    from mavproxy_fault.wire.log_walk import LogFrames, first_stamp, unroll

    at, t_us = np.empty(CACHED_FRAMES, np.int64), np.empty(CACHED_FRAMES, np.int64)
    frames = LogFrames(at, t_us, np.empty(CACHED_FRAMES, np.int16))
    resume = (0, 0, 0, first_stamp(data, block.runs))
    filled = CACHED_FRAMES
    while filled == CACHED_FRAMES:
        filled, resume = unroll(data, block.runs, _messages(), resume, frames)
        yield LogFrames(at[:filled], t_us[:filled], frames.slot[:filled])


def _columns(
    data: NDArray[np.uint8],
    counts: NDArray[np.int64],
    parts: Iterable["LogFrames"],
    only: Collection[str] | None = None,
) -> Columns:
    """The columns of frames, so many of each message, given part by part."""
    from mavproxy_fault.wire.log_walk import HEAD, SLACK, scatter

    names = message_names()
    lengths = _messages().lengths
    wanted = counts > 0
    if only is not None:
        wanted &= np.array([name in only for name in names])
    # Room for full payloads: cut zeros are put back.
    sizes = np.where(wanted, counts * (lengths + HEAD) + SLACK, 0)
    # Each message's rows begin at a cache line.
    begins = np.concatenate(([0], np.cumsum(sizes + -sizes % 64)))
    rows = np.zeros(int(begins[-1]), np.uint8)
    wanted_lengths = np.where(wanted, lengths, -1)
    nexts = begins[:-1].copy()
    for frames in parts:
        scatter(data, frames, wanted_lengths, nexts, rows)
    columns = {}
    for slot_ in np.flatnonzero(wanted):
        dtype = row_dtype(names[slot_])
        begin = int(begins[slot_])
        end = begin + int(counts[slot_]) * dtype.itemsize
        columns[names[slot_]] = rows[begin:end].view(dtype)
    return columns


def _frames(data: NDArray[np.uint8], some: "LogFrames") -> NDArray[np.void]:
    at, t_us, slot = some
    second = data[at] == 0xFD
    frames = np.empty(len(at), FRAMES)
    frames["t_us"] = t_us
    # MAVLink 2 has four header bytes more, two of them before the sender.
    source = at + np.where(second, 5, 3)
    frames["system"] = data[source]
    frames["component"] = data[source + 1]
    frames["seq"] = data[source - 1]
    frames["known"] = slot >= 0
    number = data[at + np.where(second, 7, 5)].astype(np.uint32)
    # MAVLink 1 has no upper id bytes: a byte of the head stands in, and counts nothing.
    high = np.where(second, at, 0)
    number += np.where(second, data[high + 8].astype(np.uint32) << 8, 0)
    number += np.where(second, data[high + 9].astype(np.uint32) << 16, 0)
    frames["id"] = number
    return frames


def read_log(path: str | Path) -> Log:
    """Read a whole log."""
    data = map_bytes(Path(path))
    return _log(data, _entire_log(data))


def read_parts(path: str | Path) -> Iterator[Log]:
    """The same block by block, for logs larger than memory; `size` is the whole file's."""
    data = map_bytes(Path(path))
    for block in _blocks(data, BLOCK_FRAMES):
        yield _log(data, block)


def _log(data: NDArray[np.uint8], block: _Block) -> Log:
    frames = np.concatenate([_frames(data, some) for some in _unroll_frames(data, block)])
    columns = _columns(data, block.counts, _unroll_frames(data, block))
    return Log(columns, frames, block.junk_bytes, len(data), block.end)


def read_columns(path: str | Path, only: Collection[str] | None = None) -> Columns:
    """The columns of each message in a log.

    Returns
    -------
    dict
        By message name a structured array, one row per frame in the log's order: `t_us` (the log's
        stamp, microseconds), `system`, `component`, `seq`, then the message's fields in their units
        on the wire (arrays have shape (n, length), text is bytes). A field called like one of the
        first four has `_` appended.
    """
    data = map_bytes(Path(path))
    block = _entire_log(data)
    return _columns(data, block.counts, _unroll_frames(data, block), only)


def read_blocks(path: str | Path, only: Collection[str] | None = None) -> Iterator[Columns]:
    """The same block by block (131,072 frames each), for logs larger than memory."""
    data = map_bytes(Path(path))
    for block in _blocks(data, BLOCK_FRAMES):
        yield _columns(data, block.counts, _unroll_frames(data, block), only)


def read_ordered(
    path: str | Path,
    only: Collection[str],
    frames: int = ORDERED_FRAMES,
    junk: list[int] | None = None,
) -> Iterator[tuple[Columns, dict[str, NDArray[np.int64]]]]:
    """The columns of so many frames at a time, with the place (n,) of each row among all frames.

    Bytes that belong to no frame are added to the first number of `junk`.
    """
    yield from read_ordered_bytes(map_bytes(Path(path)), only, frames, junk)


def read_ordered_bytes(
    data: NDArray[np.uint8],
    only: Collection[str],
    frames: int = ORDERED_FRAMES,
    junk: list[int] | None = None,
) -> Iterator[tuple[Columns, dict[str, NDArray[np.int64]]]]:
    """The same of a log's bytes (n,) in memory."""
    slots = {name: slot for slot, name in enumerate(message_names())}
    for block in _blocks(data, frames):
        if junk is not None:
            junk[0] += block.junk_bytes
        parts = [
            # Copies, as the arrays are used again for the next part.
            type(some)(some.at.copy(), some.t_us.copy(), some.slot.copy())
            for some in _unroll_frames(data, block)
        ]
        columns = _columns(data, block.counts, parts, only)
        slot = np.concatenate([frames.slot for frames in parts])
        yield columns, {name: np.flatnonzero(slot == slots[name]) for name in columns}


def extent_us(path: str | Path) -> tuple[int, int] | None:
    """Stamps of the first and last frame, found near the ends of the file; None without frames."""
    data = map_bytes(Path(path))
    ends: list[int] = []
    # A log of gigabytes must not be walked for its two ends.
    for part in (data[:END_BYTES], data[-END_BYTES:]):
        for _, t_us, _ in _unroll_frames(part, _entire_log(part)):
            ends.extend(t_us[[0, -1]].tolist() if len(t_us) else [])
    return (ends[0], ends[-1]) if ends else None


def read_records(path: str | Path) -> Iterator[tuple[int, bytes, Layout | None]]:
    """Stamp, bytes and layout of every frame in order; None where the message is unknown."""
    data = map_bytes(Path(path))
    layouts = [message_layout(name) for name in message_names()]
    for block in _blocks(data, BLOCK_FRAMES):
        for at, t_us, slot in _unroll_frames(data, block):
            second = data[at] == 0xFD
            signed = second & (data[at + 2] & SIGNED == SIGNED)
            ends = at + data[at + 1] + np.where(second, HEADER_V2 + 2, HEADER_V1 + 2)
            ends += np.where(signed, SIGNATURE_LENGTH, 0)
            rows = (at.tolist(), ends.tolist(), t_us.tolist(), slot.tolist())
            for start, end, stamp, which in zip(*rows, strict=True):
                found = layouts[which] if which >= 0 else None
                yield stamp, data[start:end].tobytes(), found


def read_frames(path: str | Path) -> Iterator[tuple[int, Frame]]:
    """Stamp (microseconds) and frame of every message the dialect knows, in order."""
    for t_us, raw, found in read_records(path):
        if found is not None:
            yield t_us, Frame(raw, found)


def log_record(t_us: int, frame: bytes) -> bytes:
    """One record of a log."""
    return struct.pack(">Q", t_us) + frame


def write_log(path: str | Path, frames: Iterable[tuple[int, bytes]]) -> None:
    """Write stamps and frames as a log."""
    with Path(path).open("wb") as file:
        for t_us, frame in frames:
            file.write(log_record(t_us, frame))
