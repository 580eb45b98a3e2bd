"""Fewer samples that still hold the extremes: for long curves, and for logs larger than memory.

A log beyond `WHOLE_BYTES` is read block by block. Of each message that comes often, every so many
rows are kept, and those with the least and the greatest value of each field, so that no peak is
lost; what is said seldom (texts, modes, parameters) is kept whenever it changes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.report.recordings.link_quality import LastFrame, sum_stretches
from analysis.report.recordings.reading_bar import ReportProgress
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.tlog import Columns
from mavproxy_fault.wire.written import written_bytes

WHOLE_BYTES = 128_000_000  # of a log; beyond, it is thinned
ROWS = 300_000  # of one message kept of a thinned log, at the most
LEAST_RECORD = 32  # bytes: records are on average longer
SENDING = ("t_us", "system", "component", "seq")
LONGEST_VECTOR = 4  # array fields whose elements are looked at one by one
HEAD = 11  # bytes of a row that say when and by whom it was sent

Rows = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class TlogContents:
    """What a report needs of a tlog; `thinned` if rows were left out."""

    columns: Columns
    links: NDArray[np.void]
    frames: int
    unknown: int
    junk_bytes: int
    size: int
    thinned: bool


def extreme_indices(value: NDArray[np.float64], buckets: int) -> NDArray[np.int64]:
    """Places (k,) of the least and greatest of values (n,) in each of so many equal stretches."""
    n = len(value)
    size = -(-n // buckets)
    whole = np.full(buckets * size, np.nan)
    whole[:n] = value
    table = whole.reshape(buckets, size)
    finite = np.isfinite(table)
    some = finite.any(axis=1)
    # NaN must never win.
    low = np.where(finite, table, np.inf).argmin(axis=1)
    high = np.where(finite, table, -np.inf).argmax(axis=1)
    starts = np.arange(buckets) * size
    return np.unique(np.concatenate(((starts + low)[some], (starts + high)[some])))


def read_contents(path: Path, told: ReportProgress) -> TlogContents:
    """A tlog, thinned if it is large; `told` is called with the share that is read."""
    size = written_bytes(path)
    thin = size > WHOLE_BYTES
    # What each block may keep, so that all blocks together keep ROWS.
    budget = max(60, ROWS * tlog.BLOCK_FRAMES * LEAST_RECORD // max(size, 1))
    parts: dict[str, list[Rows]] = {}
    links: list[NDArray[np.void]] = []
    senders: dict[int, LastFrame] = {}
    frames = unknown = junk_bytes = 0
    for part in tlog.read_parts(path) if thin else [tlog.read_log(path)]:
        for name, rows in part.columns.items():
            kept = [thin_rows(some, budget) for some in _by_system(rows)] if thin else [rows]
            parts.setdefault(name, []).extend(kept)
        links.append(sum_stretches(part.frames, senders))
        frames += len(part.frames)
        unknown += int((~part.frames["known"]).sum())
        junk_bytes += part.junk_bytes
        told(part.end / part.size)
    columns = {name: some[0] if len(some) == 1 else _sorted(some) for name, some in parts.items()}
    return TlogContents(columns, np.concatenate(links), frames, unknown, junk_bytes, size, thin)


def _by_system(rows: Rows) -> Iterator[Rows]:
    for system in np.unique(rows["system"]):
        yield rows[rows["system"] == system]


def _sorted(some: Sequence[Rows]) -> Rows:
    rows = np.concatenate(some)
    return rows[np.argsort(rows["t_us"], kind="stable")]


def thin_rows(rows: Rows, budget: int) -> Rows:
    """About `budget` rows of a message's (n,): evenly spaced ones and those of the extremes."""
    if len(rows) <= budget:
        return rows
    names = rows.dtype.names or ()
    # Texts and modes are not sampled: every change is an event.
    if "custom_mode" in names or any(rows.dtype[name].kind == "S" for name in names):
        return rows[_changes(rows)]
    curves = [column for name in names if name not in SENDING for column in _curves(rows[name])]
    # Half of the budget for extremes, two for each stretch and curve.
    buckets = max(1, budget // (4 * max(len(curves), 1)))
    picked = [np.arange(0, len(rows), max(1, 2 * len(rows) // budget))]
    picked += [extreme_indices(curve, buckets) for curve in curves]
    return rows[np.unique(np.concatenate(picked))]


def _curves(column: NDArray[np.generic]) -> list[NDArray[np.float64]]:
    if column.ndim == 1:
        return [column.astype(float)]
    return [column[:, i].astype(float) for i in range(min(column.shape[1], LONGEST_VECTOR))]


def _changes(rows: Rows) -> NDArray[np.bool_]:
    """Rows that say something else than the one before."""
    content = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)[:, HEAD:]
    differs = (content[1:] != content[:-1]).any(axis=1)
    return np.concatenate(([True], differs))
