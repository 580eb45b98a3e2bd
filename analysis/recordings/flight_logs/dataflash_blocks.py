"""Find the messages of a dataflash log, block by block, whatever bytes are wrong or missing.

A message counts only where the header of another one or the end of the log follows it: a length
that is wrong leads nowhere. One message whose header has a wrong byte counts if it fills the bytes
between two others exactly.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.dataflash_formats import (
    FORMAT_BYTES,
    FORMATS,
    HEAD,
    MAGIC,
    Bytes,
    MessageFormat,
    assign_types,
    find_formats,
)
from analysis.recordings.flight_logs.logged_rows import BLOCK_BYTES, gather_rows

LONGEST = 255 + HEAD  # more than a message has: its length is one byte
Places = NDArray[np.int64]


@dataclass(slots=True)
class BlockWalk:
    """Formats by type, and counters of a walk over a log."""

    skipped_bytes: int = 0  # that belong to no message found
    cut: bool = False  # whether the file ends within a message
    boots: list[int] = field(default_factory=list)  # offsets of the format of the formats
    forms: dict[int, MessageFormat] = field(default_factory=dict)


def read_formats(path: Path, size: int) -> dict[int, MessageFormat]:
    """Formats by type of all messages in the first `size` bytes of a log."""
    found: list[MessageFormat] = []
    spacings: dict[int, Counter[int]] = {}
    for _, data, _ in _blocks(path, size, FORMAT_BYTES + LONGEST):
        found += [form for form in find_formats(data.tobytes()) if form not in found]
        heads = _headers(data)
        types, steps = data[heads[:-1] + 2], np.diff(heads)
        short = steps <= LONGEST
        pairs, counts = np.unique(
            types[short].astype(np.int64) << 16 | steps[short], return_counts=True
        )
        for pair, count in zip(pairs.tolist(), counts.tolist(), strict=True):
            spacings.setdefault(pair >> 16, Counter())[pair & 0xFFFF] += count
    return assign_types(found, spacings)


def walk_blocks(path: Path, size: int, walk: BlockWalk) -> Iterator[tuple[int, Bytes, Places]]:
    """Offset and bytes of each block, and where messages start in it, in order.

    `walk.forms` has the formats; the counts of `walk` are updated.
    """
    lengths = np.zeros(256, np.int64)
    for number, form in walk.forms.items():
        lengths[number] = form.length
    lengths[FORMATS] = FORMAT_BYTES
    walk.forms.pop(FORMATS, None)
    carry, at = np.empty(0, np.uint8), 0
    for _, fresh, last in _blocks(path, size, 0):
        data = np.concatenate([carry, fresh])
        starts, end = find_messages(data, lengths, last)
        known = int(lengths[data[starts + 2]].sum())
        formats = starts[data[starts + 2] == FORMATS]
        walk.boots += (formats[data[formats + HEAD] == FORMATS] + at).tolist()
        walk.skipped_bytes += end - known
        if last and len(data) > end:
            rest = data[end:]
            # An incomplete last message is normal: the logger was switched off.
            walk.cut = rest[:2].tobytes() == MAGIC[: len(rest)] and (
                len(rest) < HEAD or lengths[rest[2]] > len(rest)
            )
            walk.skipped_bytes += 0 if walk.cut else len(rest)
        yield at, data, starts
        carry, at = data[end:], at + end


def _blocks(path: Path, size: int, overlap: int) -> Iterator[tuple[int, Bytes, bool]]:
    """Offset and bytes of each block of a file, overlapping by some bytes, and whether it is the
    last."""
    with path.open("rb") as file:
        at = 0
        while True:
            file.seek(max(at - overlap, 0))
            end = min(at + BLOCK_BYTES, size)
            data = np.frombuffer(file.read(end - max(at - overlap, 0)), np.uint8)
            yield max(at - overlap, 0), data, end >= size
            if end >= size:
                return
            at = end


def _headers(data: Bytes) -> Places:
    """Where the first two bytes of a header are, with a type behind them."""
    first = data[:-2] == MAGIC[0]
    first &= data[1:-1] == MAGIC[1]
    return np.flatnonzero(first)


def find_messages(data: Bytes, lengths: Places, last: bool) -> tuple[Places, int]:
    """Starts of the messages in a block (n,), and where the first unfinished one starts.

    `lengths` (256,) are in bytes by type, 0 for a type without a format; `last` is whether the log
    ends with this block.
    """
    size = len(data)
    heads = _headers(data)
    heads = heads[lengths[data[heads + 2]] > 0]
    every = _headers(data)
    ends = heads + lengths[data[heads + 2]]
    next_head = np.append(every, size)[np.minimum(np.searchsorted(every, ends), len(every))]
    # Less than a header may be left at the end of the log.
    good = (next_head == ends) | ((ends <= size) & (size - ends < HEAD) & last)
    if not last:
        # What follows these is in the next block.
        good &= heads < size - 2 * LONGEST
    starts = _without_overlap(heads[good], ends[good])
    starts = _with_repaired(data, starts, lengths, size if last else None)
    if not len(starts):
        return starts, size if last else max(size - 2 * LONGEST, 0)
    end = int(starts[-1] + lengths[data[starts[-1] + 2]])
    if not last:
        # Bytes that are no messages are passed over as far as nothing can begin in them.
        end = max(end, size - 4 * LONGEST)
    return starts, end


def _without_overlap(starts: Places, ends: Places) -> Places:
    """The messages that begin where or after the one before ends; headers inside are data."""
    if not np.any(starts[1:] < ends[:-1]):
        return starts
    keep, free = [], 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if start >= free:
            keep.append(start)
            free = end
    return np.array(keep, np.int64)


def _with_repaired(data: Bytes, starts: Places, lengths: Places, size: int | None) -> Places:
    """Add messages with one wrong header byte, and the complete one before such a message."""
    ends = (
        np.append(0, starts + lengths[data[starts + 2]]) if len(starts) else np.zeros(1, np.int64)
    )
    stops = np.append(starts, size) if size is not None else starts
    ends = ends[: len(stops)]
    gaps = stops - ends
    open_gap = gaps > HEAD
    begin, gap = ends[open_gap], gaps[open_gap]
    alone = _fills(data, begin, gap, lengths)
    types = data[begin + 2]
    complete = (data[begin] == MAGIC[0]) & (data[begin + 1] == MAGIC[1])
    own = np.where(complete, lengths[types], 0)
    two = (own > 0) & (gap - own > HEAD)
    two[two] = _fills(data, begin[two] + own[two], gap[two] - own[two], lengths)
    found = [starts, begin[alone], begin[two], begin[two] + own[two]]
    return np.sort(np.concatenate(found))


def _fills(data: Bytes, begin: Places, gap: Places, lengths: Places) -> NDArray[np.bool_]:
    """Whether one message with a wrong first or second byte fills each gap."""
    half = (data[begin] == MAGIC[0]) | (data[begin + 1] == MAGIC[1])
    return np.asarray(half & (lengths[data[begin + 2]] == gap))


def rows_by_type(
    data: Bytes, at: int, starts: Places, forms: Mapping[int, MessageFormat]
) -> Iterator[tuple[MessageFormat, NDArray[np.void]]]:
    """The rows of every type of message in a block, except formats."""
    types = data[starts + 2]
    for number in np.unique(types).tolist():
        if number in forms:
            form, begins = forms[number], starts[types == number] + HEAD
            yield form, gather_rows(data, at - HEAD, begins, form.dtype(), form.length - HEAD)
