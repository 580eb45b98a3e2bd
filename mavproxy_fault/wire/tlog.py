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

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.errors import ConfigError
from mavproxy_fault.wire.dialect import Layout, known, message_names
from mavproxy_fault.wire.frame import HEADER_V1, HEADER_V2, SIGNATURE_LENGTH, SIGNED, Frame

Columns = dict[str, NDArray[np.void]]

BLOCK_FRAMES = 1 << 17
END_BYTES = 1 << 16  # as much of a log's beginning or end as shows its first or last frame


@dataclass(frozen=True, slots=True)
class _Index:
    """Where the frames of a block are; arrays of shape (n,)."""

    at: NDArray[np.int64]
    t_us: NDArray[np.int64]
    slot: NDArray[np.int16]  # place of its message in `message_names`, -1 if unknown
    counts: NDArray[np.int64]  # frames of each slot
    junk_bytes: int


@dataclass(frozen=True, slots=True)
class Log:
    """A log read.

    Attributes
    ----------
    columns : dict of structured arrays
        Per message `t_us` (the log's stamp), `system`, `component`, `seq` and the message's fields.
    frames : structured array
        Every frame in the log's order: `t_us`, `id`, `system`, `component`, `seq`, `known`.
    junk_bytes : int
        Bytes that belong to no frame found: broken records, a cut tail, foreign bytes.
    size : int
        Bytes of the file.
    """

    columns: Columns
    frames: NDArray[np.void]
    junk_bytes: int
    size: int


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
    taken = {"t_us", "system", "component", "seq"}
    for field in known(name).fields.values():
        column = field.name + "_" if field.name in taken else field.name
        if field.type == "char":
            fields.append((column, f"S{max(field.count, 1)}"))
        elif field.count:
            fields.append((column, np.dtype("<" + field.code).str, (field.count,)))
        else:
            fields.append((column, np.dtype("<" + field.code).str))
    return np.dtype(fields)


@cache
def _tables() -> tuple[NDArray[np.int16], NDArray[np.uint64], NDArray[np.int64]]:
    """Slot by message id; CRC extra and payload length by slot."""
    layouts = [known(name) for name in message_names()]
    slots = np.full(max(item.id for item in layouts) + 1, -1, np.int16)
    for slot, item in enumerate(layouts):
        slots[item.id] = slot
    extras = np.array([item.crc_extra for item in layouts], np.uint64)
    lengths = np.array([item.length for item in layouts], np.int64)
    return slots, extras, lengths


def map_bytes(path: Path) -> NDArray[np.uint8]:
    """The bytes of a file, mapped.

    Raises
    ------
    ConfigError
        If the file is missing, not a file, or empty.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file; give the path of a log")
    if path.stat().st_size == 0:
        raise ConfigError(f"{path}: the log is empty; nothing was recorded")
    return np.memmap(path, np.uint8, mode="r")


def _index(data: NDArray[np.uint8]) -> Iterator[_Index]:
    """The frames of a log, block by block."""
    from mavproxy_fault.wire.walk import crc_tables, walk

    slots, extras, lengths = _tables()
    tables = crc_tables()
    start = 0
    while start < len(data):
        at = np.empty(BLOCK_FRAMES, np.int64)
        t_us = np.empty(BLOCK_FRAMES, np.int64)
        slot = np.empty(BLOCK_FRAMES, np.int16)
        counts = np.zeros(len(lengths), np.int64)
        found, start, junk, slips = walk(data, start, slots, extras, tables, at, t_us, slot, counts)
        stamps = t_us[:found]
        yield _Index(at[:found], _mended(stamps) if slips else stamps, slot[:found], counts, junk)


def _whole(data: NDArray[np.uint8]) -> _Index:
    """The frames of a whole log."""
    blocks = list(_index(data))
    if len(blocks) == 1:
        return blocks[0]
    return _Index(
        np.concatenate([block.at for block in blocks]),
        np.concatenate([block.t_us for block in blocks]),
        np.concatenate([block.slot for block in blocks]),
        np.sum([block.counts for block in blocks], axis=0),
        sum(block.junk_bytes for block in blocks),
    )


def _mended(t_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stamps with damaged ones (-1, or alone far off) replaced by the one before.

    A clock that jumps and stays there is no damage.
    """
    from mavproxy_fault.wire.walk import SLIP_US

    if len(t_us) < 3:
        return t_us
    before = np.concatenate((t_us[:1], t_us[:-1]))
    after = np.concatenate((t_us[1:], t_us[-1:]))
    lone = (np.abs(t_us - before) > SLIP_US) & (np.abs(t_us - after) > SLIP_US)
    lone &= np.abs(after - before) < SLIP_US
    lone |= t_us < 0
    lone[0] |= abs(int(t_us[0]) - int(t_us[1])) > SLIP_US > abs(int(t_us[1]) - int(t_us[2]))
    if not lone.any():
        return t_us
    whole = np.flatnonzero(~lone)
    if len(whole) == 0:
        return np.zeros_like(t_us)
    nearest = np.maximum(np.searchsorted(whole, np.arange(len(t_us)), side="right") - 1, 0)
    return t_us[whole[nearest]]


def _columns(data: NDArray[np.uint8], index: _Index, only: Collection[str] | None) -> Columns:
    from mavproxy_fault.wire.walk import HEAD, SLACK, scatter

    names = message_names()
    lengths = _tables()[2]
    wanted = index.counts > 0
    if only is not None:
        wanted &= np.isin(names, list(only))
    sizes = np.where(wanted, index.counts * (lengths + HEAD) + SLACK, 0)
    begins = np.concatenate(([0], np.cumsum(sizes + -sizes % 64)))
    rows = np.zeros(int(begins[-1]), np.uint8)
    wanted_lengths = np.where(wanted, lengths, -1)
    scatter(data, index.at, index.t_us, index.slot, wanted_lengths, begins[:-1].copy(), rows)
    columns = {}
    for slot in np.flatnonzero(wanted):
        dtype = row_dtype(names[slot])
        begin = int(begins[slot])
        columns[names[slot]] = rows[begin : begin + index.counts[slot] * dtype.itemsize].view(dtype)
    return columns


def _frames(data: NDArray[np.uint8], index: _Index) -> NDArray[np.void]:
    at = index.at
    second = data[at] == 0xFD
    frames = np.empty(len(at), FRAMES)
    frames["t_us"] = index.t_us
    source = at + np.where(second, 5, 3)
    frames["system"] = data[source]
    frames["component"] = data[source + 1]
    frames["seq"] = data[source - 1]
    frames["known"] = index.slot >= 0
    number = data[at + np.where(second, 7, 5)].astype(np.uint32)
    high = np.where(second, at, 0)
    number += np.where(second, data[high + 8].astype(np.uint32) << 8, 0)
    number += np.where(second, data[high + 9].astype(np.uint32) << 16, 0)
    frames["id"] = number
    return frames


def read_log(path: str | Path, only: Collection[str] | None = None) -> Log:
    """Read a whole log; with `only`, columns of these messages alone."""
    data = map_bytes(Path(path))
    index = _whole(data)
    return Log(_columns(data, index, only), _frames(data, index), index.junk_bytes, len(data))


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
    return _columns(data, _whole(data), only)


def read_blocks(path: str | Path, only: Collection[str] | None = None) -> Iterator[Columns]:
    """The same block by block (131,072 frames each), for logs larger than memory."""
    data = map_bytes(Path(path))
    for index in _index(data):
        yield _columns(data, index, only)


def extent_us(path: str | Path) -> tuple[int, int] | None:
    """Stamps of the first and last frame, found near the ends of the file; None without frames."""
    data = map_bytes(Path(path))
    ends: list[int] = []
    for part in (data[:END_BYTES], data[-END_BYTES:]):
        for index in _index(part):
            ends.extend(index.t_us[[0, -1]].tolist() if len(index.t_us) else [])
    return (ends[0], ends[-1]) if ends else None


def read_records(path: str | Path) -> Iterator[tuple[int, bytes, Layout | None]]:
    """Stamp, bytes and layout of every frame in order; None where the message is unknown."""
    data = map_bytes(Path(path))
    layouts = [known(name) for name in message_names()]
    for index in _index(data):
        second = data[index.at] == 0xFD
        signed = second & (data[index.at + 2] & SIGNED == SIGNED)
        ends = index.at + data[index.at + 1] + np.where(second, HEADER_V2 + 2, HEADER_V1 + 2)
        ends += np.where(signed, SIGNATURE_LENGTH, 0)
        rows = (index.at.tolist(), ends.tolist(), index.t_us.tolist(), index.slot.tolist())
        for at, end, t_us, slot in zip(*rows, strict=True):
            yield t_us, data[at:end].tobytes(), layouts[slot] if slot >= 0 else None


def read_frames(path: str | Path) -> Iterator[tuple[int, Frame]]:
    """Stamp (microseconds) and frame of every message the dialect knows, in order."""
    for t_us, raw, found in read_records(path):
        if found is not None:
            yield t_us, Frame(raw, found)


def record(t_us: int, frame: bytes) -> bytes:
    """One record of a log."""
    return struct.pack(">Q", t_us) + frame


def write(path: str | Path, frames: Iterable[tuple[int, bytes]]) -> None:
    """Write stamps and frames as a log."""
    with Path(path).open("wb") as file:
        for t_us, frame in frames:
            file.write(record(t_us, frame))
