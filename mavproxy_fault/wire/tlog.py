"""Reading and writing tlogs, the telemetry logs of ground stations.

A tlog is a sequence of records: a timestamp (microseconds since 1970 or on the vehicle's clock) as
a big-endian 64-bit integer, then the bytes of one frame. Its content cannot be trusted: bytes may
be missing or wrong anywhere, the last record is often truncated, logs are concatenated, clocks
jump. Every frame with a correct checksum is found; skipped bytes are counted.

Files are memory-mapped: `read_columns` needs memory for the columns it returns, `read_blocks` for
one block, whatever the size of the file.
"""

import mmap
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.crc import SLICES, slicing_tables
from mavproxy_fault.wire.dialect import Layout, message_layout, message_names
from mavproxy_fault.wire.frame import HEADER_V1, HEADER_V2, Frame, frame_header
from mavproxy_fault.wire.written import written_bytes

if TYPE_CHECKING:  # numba is loaded only when a log is read
    from mavproxy_fault.wire.log_walk import LogFrames, LogMessages

Columns = dict[str, NDArray[np.void]]
_Block = tuple["LogFrames", int, int]  # frames, the byte behind them, and bytes outside of any

BLOCK_FRAMES = 1 << 17  # bounds the memory of one block
ORDERED_FRAMES = 1 << 15  # of `read_ordered`: fewer add calls, more exceed the processor's cache
END_BYTES = 1 << 16  # read at either end of a log to find its first and last frame


@dataclass(frozen=True, slots=True)
class Log:
    """A decoded log or part of one.

    Attributes
    ----------
    columns : dict of structured arrays
        By message: `t_us` (log timestamp), `system`, `component`, `seq` and the message's fields.
    frames : structured array
        Every frame in log order: `t_us`, `id`, `system`, `component`, `seq`, `known`.
    junk_bytes : int
        Bytes outside any frame: broken records, a truncated end, foreign bytes.
    size, end : int
        Written bytes of the file, and the number of them read so far.
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
    """Return the packed dtype of a message's rows, fields in wire order."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [
        ("t_us", "<i8"),
        ("system", "u1"),
        ("component", "u1"),
        ("seq", "u1"),
    ]
    # A message's own fields of these names get an underscore.
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
    """Return the dialect in the form the compiled log reader uses."""
    from mavproxy_fault.wire.log_walk import LogMessages

    layouts = [message_layout(name) for name in message_names()]
    # A table by message id: faster in kernels than a dictionary.
    slots = np.full(max(item.id for item in layouts) + 1, -1, np.int16)
    for slot, item in enumerate(layouts):
        slots[item.id] = slot
    extras = np.array([item.crc_extra for item in layouts], np.uint64)
    lengths = np.array([item.length for item in layouts], np.int64)
    tables = np.array(slicing_tables(), np.uint16).reshape(SLICES, 256)
    return LogMessages(slots, extras, lengths, tables)


def map_bytes(path: Path) -> NDArray[np.uint8]:
    """Memory-map the bytes of a log.

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
    # Pages are loaded on demand: a log may be larger than memory.
    return np.memmap(path, np.uint8, mode="r", shape=(size,))


def _blocks(data: NDArray[np.uint8], count: int) -> Iterator[_Block]:
    """Yield the frames of a log, up to `count` at a time, where they end, and the bytes between."""
    from mavproxy_fault.wire.log_walk import LogFrames, repair_stamps, walk

    end = 0
    while end < len(data):
        kinds = (np.int64, np.int64, np.int64, np.int16)
        room = LogFrames._make(np.empty(count, kind) for kind in kinds)
        found, end, junk_bytes = walk(data, end, _messages(), room)
        frames = LogFrames._make(column[:found] for column in room)
        repair_stamps(frames.t_us)
        yield frames, end, junk_bytes
        # Pages that were read count as memory of the process until they are given back.
        if isinstance(data.base, mmap.mmap):
            data.base.madvise(mmap.MADV_DONTNEED)


def _entire_log(data: NDArray[np.uint8]) -> _Block:
    """Return the entire log as one block."""
    blocks = list(_blocks(data, BLOCK_FRAMES))
    frames = type(blocks[0][0])(
        *map(np.concatenate, zip(*(one for one, *_ in blocks), strict=True))
    )
    return frames, blocks[-1][1], sum(junk_bytes for *_, junk_bytes in blocks)


def _columns(
    data: NDArray[np.uint8], frames: "LogFrames", only: Collection[str] | None = None
) -> Columns:
    """Decode frames into columns, one structured array for each message."""
    from mavproxy_fault.wire.log_walk import HEAD, SLACK, scatter

    names = message_names()
    lengths = _messages().lengths
    counts = np.bincount(frames.slot[frames.slot >= 0], minlength=len(names))
    wanted = counts > 0
    if only is not None:
        wanted &= np.array([name in only for name in names])
    # Space for full payloads: truncated zeros are restored.
    sizes = np.where(wanted, counts * (lengths + HEAD) + SLACK, 0)
    # Align each message's rows to a cache line.
    begins = np.concatenate(([0], np.cumsum(sizes + -sizes % 64)))
    rows = np.zeros(int(begins[-1]), np.uint8)
    wanted_lengths = np.where(wanted, lengths, -1)
    scatter(data, frames, wanted_lengths, begins[:-1].copy(), rows)
    columns = {}
    for slot_ in np.flatnonzero(wanted):
        dtype = row_dtype(names[slot_])
        begin = int(begins[slot_])
        end = begin + int(counts[slot_]) * dtype.itemsize
        columns[names[slot_]] = rows[begin:end].view(dtype)
    return columns


def _frames(data: NDArray[np.uint8], some: "LogFrames") -> NDArray[np.void]:
    at, t_us, _, slot = some
    second = data[at] == 0xFD
    frames = np.empty(len(at), FRAMES)
    frames["t_us"] = t_us
    # The MAVLink 2 header has four more bytes, two of them before the sender.
    source = at + np.where(second, 5, 3)
    frames["system"] = data[source]
    frames["component"] = data[source + 1]
    frames["seq"] = data[source - 1]
    frames["known"] = slot >= 0
    number = data[at + np.where(second, 7, 5)].astype(np.uint32)
    # MAVLink 1 has no upper id bytes: read a valid offset instead and discard the value.
    high = np.where(second, at, 0)
    number += np.where(second, data[high + 8].astype(np.uint32) << 8, 0)
    number += np.where(second, data[high + 9].astype(np.uint32) << 16, 0)
    frames["id"] = number
    return frames


def read_log(path: str | Path) -> Log:
    """Read an entire log."""
    data = map_bytes(Path(path))
    return _log(data, _entire_log(data))


def read_parts(path: str | Path) -> Iterator[Log]:
    """Read a log block by block, if it may exceed memory; `size` is that of the entire file."""
    data = map_bytes(Path(path))
    for block in _blocks(data, BLOCK_FRAMES):
        yield _log(data, block)


def _log(data: NDArray[np.uint8], block: _Block) -> Log:
    known, end, junk = block
    frames = _frames(data, known)
    # Only as far as the block goes, not to the end of the log.
    others = _foreign_frames(data[:end], known, frames)
    if len(others.at):
        junk -= int((others.end - others.at).sum()) + 8 * len(others.at)
        order = np.argsort(np.concatenate([known.at, others.at]), kind="stable")
        frames = np.concatenate([frames, _frames(data, others)])[order]
    return Log(_columns(data, known), frames, junk, len(data), end)


def _foreign_frames(
    data: NDArray[np.uint8], known: "LogFrames", frames: NDArray[np.void]
) -> "LogFrames":
    """Records of another dialect, which uses a known message id for another message.

    Their lengths fill the bytes between two verified frames, and no frame with their id has a
    valid checksum in this log; a corrupted frame has an id that other frames have too.
    """
    from mavproxy_fault.wire.log_walk import LogFrames

    begins = np.append(known.at[1:] - 8, len(data))
    found: list[tuple[int, int]] = []
    for gap in np.flatnonzero(begins - known.end > HEADER_V1 + 10).tolist():
        first = int(known.end[gap])
        # Plain bytes: a log may have millions of such records.
        raw, place, some = data[first : begins[gap]].tobytes(), 8, []
        while place + HEADER_V2 < len(raw) and raw[place] in (0xFD, 0xFE):
            _, _, end = frame_header(raw, place, len(raw))
            some.append((first + place, first + end))
            place = end + 8
        found += some if place == len(raw) + 8 else []
    at, ends = np.array(found, np.int64).reshape(-1, 2).T
    stamps = data[at[:, None] - np.arange(8, 0, -1)].view(">i8")[:, 0].astype(np.int64)
    others = LogFrames(at, stamps, ends, np.full(len(at), -1, np.int16))
    foreign = ~np.isin(_frames(data, others)["id"], frames["id"][frames["known"]])
    return LogFrames._make(column[foreign] for column in others)


def read_columns(path: str | Path, only: Collection[str] | None = None) -> Columns:
    """Read a log into one structured array per message.

    Returns
    -------
    dict
        By message name a structured array, one row per frame in log order: `t_us` (log timestamp,
        microseconds), `system`, `component`, `seq`, then the message's fields in wire units (arrays
        have shape (n, length), text is bytes). A field with one of the first four names has `_`
        appended.
    """
    data = map_bytes(Path(path))
    return _columns(data, _entire_log(data)[0], only)


def read_blocks(path: str | Path, only: Collection[str] | None = None) -> Iterator[Columns]:
    """Read columns in blocks of 131,072 frames, for logs larger than memory."""
    data = map_bytes(Path(path))
    for frames, *_ in _blocks(data, BLOCK_FRAMES):
        yield _columns(data, frames, only)


def read_ordered(
    data: NDArray[np.uint8],
    only: Collection[str],
    junk: list[int] | None = None,
) -> Iterator[tuple[Columns, dict[str, NDArray[np.int64]]]]:
    """Read columns of up to 32,768 frames at a time, with each row's index (n,) among them.

    `data` are a log's bytes (n,), such as those of `map_bytes`. The number of bytes outside any
    frame is added to `junk[0]`.
    """
    slots = {name: slot for slot, name in enumerate(message_names())}
    for found, _, junk_bytes in _blocks(data, ORDERED_FRAMES):
        if junk is not None:
            junk[0] += junk_bytes
        columns = _columns(data, found, only)
        yield columns, {name: np.flatnonzero(found.slot == slots[name]) for name in columns}


def extent_us(path: str | Path) -> tuple[int, int] | None:
    """Return the timestamps of the first and last frame; None if there is no frame."""
    data = map_bytes(Path(path))
    # Read only the ends: a log may have gigabytes.
    ends = [_entire_log(part)[0].t_us for part in (data[:END_BYTES], data[-END_BYTES:])]
    stamps = np.concatenate(ends)
    return (int(stamps[0]), int(stamps[-1])) if len(stamps) else None


def read_records(path: str | Path) -> Iterator[tuple[int, bytes, Layout | None]]:
    """Yield timestamp, bytes and layout (None if unknown) of every frame in order."""
    data = map_bytes(Path(path))
    layouts = [message_layout(name) for name in message_names()]
    for frames, *_ in _blocks(data, BLOCK_FRAMES):
        for start, stamp, end, which in zip(*(one.tolist() for one in frames), strict=True):
            layout = layouts[which] if which >= 0 else None
            yield stamp, data[start:end].tobytes(), layout


def read_frames(path: str | Path) -> Iterator[tuple[int, Frame]]:
    """Yield timestamp (microseconds) and frame of every message in the dialect, in order."""
    for t_us, raw, layout in read_records(path):
        if layout is not None:
            yield t_us, Frame(raw, layout)


def log_record(t_us: int, frame: bytes) -> bytes:
    """Encode one record of a tlog."""
    return struct.pack(">Q", t_us) + frame
