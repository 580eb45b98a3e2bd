"""Thin long curves and large logs to fewer samples, keeping the extremes.

A log larger than `WHOLE_BYTES` is read block by block. Of frequent messages, evenly spaced rows are
kept, and those with the minimum and maximum of each field, so that no peak is lost; rare messages
(texts, modes, parameters) are kept whenever they change.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.log_stamps import StampState, steady_stamps
from analysis.recordings.flight_logs.logged_rows import BLOCK_BYTES, Rows, Thin
from analysis.report.curves.recording import element_columns
from analysis.report.recordings.from_tlog import merge_logs
from analysis.report.recordings.link_quality import LastFrame, sum_stretches
from analysis.report.recordings.reading_bar import ReportProgress
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.tlog import Columns
from mavproxy_fault.wire.written import written_bytes

WHOLE_BYTES = 128_000_000  # larger logs are thinned; chosen to limit memory use
ROWS = 30_000  # kept per message of a thinned log, about; chosen to limit memory use
LEAST_RECORD = 32  # bytes; the average record is longer
SENDING = ("t_us", "system", "component", "seq", "at", "TimeUS", "timestamp")
LONGEST_VECTOR = 4  # longest array fields whose elements are searched for extremes
HEAD = 11  # bytes of a row with its time and sender
OFFSET_AND_TIME = 16  # bytes of a row of another log


@dataclass(frozen=True, slots=True)
class TlogContents:
    """The contents of a tlog that a report needs; `thinned` if rows were omitted.

    `unknown` counts the frames of messages that the dialect lacks, by id.
    """

    columns: Columns
    links: NDArray[np.void]
    frames: int
    unknown: Counter[int]
    junk_bytes: int
    size: int
    thinned: bool
    notes: list[str]


def extreme_indices(value: NDArray[np.float64], buckets: int) -> NDArray[np.int64]:
    """Indices (k,) of the minimum and maximum of values (n,) in each of `buckets` equal parts."""
    n = len(value)
    size = -(-n // buckets)
    padded = np.full(buckets * size, np.nan)
    padded[:n] = value
    table = padded.reshape(buckets, size)
    finite = np.isfinite(table)
    some = finite.any(axis=1)
    # NaN is never an extreme.
    low = np.where(finite, table, np.inf).argmin(axis=1)
    high = np.where(finite, table, -np.inf).argmax(axis=1)
    starts = np.arange(buckets) * size
    return np.unique(np.concatenate(((starts + low)[some], (starts + high)[some])))


def read_contents(path: Path, progress: ReportProgress) -> TlogContents:
    """Read a tlog, thinned if it is large; `progress` is called with the share read so far."""
    size = written_bytes(path)
    thin = size > WHOLE_BYTES
    # Row limit per block, so that all blocks together keep `ROWS`.
    budget = max(60, ROWS * tlog.BLOCK_FRAMES * LEAST_RECORD // max(size, 1))
    blocks: list[Columns] = []
    links: list[NDArray[np.void]] = []
    senders: dict[int, LastFrame] = {}
    frames = junk_bytes = 0
    unknown: Counter[int] = Counter()
    clock = StampState()
    for part in tlog.read_parts(path) if thin else [tlog.read_log(path)]:
        steady_stamps(part.frames, part.columns, clock)
        blocks.append(_thinned(part.columns, budget) if thin else part.columns)
        links.append(sum_stretches(part.frames, senders, clock.restarts_us))
        frames += len(part.frames)
        unknown.update(part.frames["id"][~part.frames["known"]].tolist())
        junk_bytes += part.junk_bytes
        progress(part.end / part.size)
    return TlogContents(
        merge_logs(blocks),
        np.concatenate(links),
        frames,
        unknown,
        junk_bytes,
        size,
        thin,
        clock.notes(),
    )


def block_thinning(size: int) -> Thin | None:
    """Thins the rows of a message in one block of a ULog or dataflash log of `size` bytes, if it is
    large."""
    if size <= WHOLE_BYTES:
        return None
    budget = max(60, ROWS * BLOCK_BYTES // size)
    return lambda rows: thin_rows(rows, budget, OFFSET_AND_TIME)


def _thinned(columns: Columns, budget: int) -> Columns:
    """The columns of a block, with up to `budget` rows of each message of each system."""
    return {
        name: np.concatenate(
            [thin_rows(rows[rows["system"] == n], budget) for n in np.unique(rows["system"])]
        )
        for name, rows in columns.items()
    }


def thin_rows(rows: Rows, budget: int, head: int = HEAD) -> Rows:
    """Thin the rows (n,) of a message to about `budget`: evenly spaced ones and the extremes.

    `head` bytes of a row differ in any case.
    """
    if len(rows) <= budget:
        return rows
    names = rows.dtype.names or ()
    # Texts and modes are kept at every change.
    if "custom_mode" in names or any(rows.dtype[name].kind == "S" for name in names):
        return rows[_changes(rows, head)]
    curves = [
        column.astype(float)
        for name in names
        if name not in SENDING and rows[name].dtype.kind in "iufb"
        for _, column in element_columns(name, rows[name], LONGEST_VECTOR)
    ]
    # Half of the budget is for extremes, two per bucket and curve.
    buckets = max(1, budget // (4 * max(len(curves), 1)))
    picked = [np.arange(0, len(rows), max(1, 2 * len(rows) // budget))]
    picked += [extreme_indices(curve, buckets) for curve in curves]
    return rows[np.unique(np.concatenate(picked))]


def _changes(rows: Rows, head: int) -> NDArray[np.bool_]:
    """Rows that differ from the row before."""
    content = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)[:, head:]
    differs = (content[1:] != content[:-1]).any(axis=1)
    return np.concatenate(([True], differs))
