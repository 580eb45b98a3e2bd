"""Export logs as tables: CSV or Parquet (one file per message), or one file for Foxglove
(MCAP) or Rerun.

A column is a field as the log names it; arrays become columns `name[0]`, `name[1]`, ... Times are
in microseconds as in the log.
"""

import csv
import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.autopilot_logs import is_autopilot_log, read_topics
from analysis.report.curves.recording import FlightData, element_columns
from analysis.report.foxglove_views import write_views
from analysis.report.rerun_views import write_rerun
from analysis.results import encode, read_results
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.wire import tlog

Table = dict[str, NDArray[Any]]
# Time columns of tlog, ULog and dataflash; the first that exists is used.
TIMES = ("t_us", "timestamp", "TimeUS")


def export_tables(paths: Sequence[Path], folder: Path, form: str, recording: FlightData) -> None:
    """Write the tables of logs (or of a run folder) to `folder` as csv, parquet, mcap or rerun.

    Raises
    ------
    ConfigError
        If a log cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        target = folder / path.stem if len(paths) > 1 else folder
        target.mkdir(exist_ok=True)
        if form == "mcap":
            _write_mcap(target / f"{path.stem}.mcap", path, recording)
            continue
        if form == "rerun":
            write_rerun(target / f"{path.stem}.rrd", recording, _timed_tables(path, recording))
            continue
        (_write_csv if form == "csv" else _write_parquet)(target, read_tables(path))


def read_tables(path: Path, *, with_results: bool = True) -> Iterator[tuple[str, Table]]:
    """Read all tables of a log or run folder; yields name and columns, a tlog's block by block."""
    if path.is_dir():
        for name in ("received", "sent"):
            if (path / f"{name}.tlog").is_file():
                for message, table in read_tables(path / f"{name}.tlog"):
                    yield f"{name}.{message}", table
        if with_results:
            yield from _result_tables(path / "results.jsonl")
        return
    if is_autopilot_log(path):
        for (name, instance), topic in read_topics(path).topics.items():
            yield f"{name}_{instance}", topic
        return
    for columns in tlog.read_blocks(path):
        for name, rows in columns.items():
            # Many tools cannot read array cells, so each element gets a column.
            fields = (element_columns(field, rows[field]) for field in rows.dtype.names or ())
            yield name, dict(itertools.chain.from_iterable(fields))


def _result_tables(path: Path) -> Iterator[tuple[str, Table]]:
    """Scalar fields of the results, one table per type; lists stay in results.jsonl."""
    if not path.is_file():
        return
    # All results of a type share their fields.
    kinds: dict[str, list[Any]] = {}
    for result in read_results(path):
        kinds.setdefault(type(result).__name__, []).append(result)
    for kind, results in kinds.items():
        names = [
            name
            for name in results[0].__struct_fields__
            if isinstance(getattr(results[0], name), (int, float, str, bool))
        ]
        yield kind, {name: np.array([getattr(r, name) for r in results]) for name in names}


def _write_csv(folder: Path, tables: Iterable[tuple[str, Table]]) -> None:
    begun = set[str]()
    for name, table in tables:
        path = folder / f"{name}.csv"
        columns = [_python_values(column) for column in table.values()]
        with path.open("a" if name in begun else "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerows([] if name in begun else [table])
            writer.writerows(zip(*columns, strict=True))
        begun.add(name)


def _python_values(column: NDArray[Any]) -> list[Any]:
    """Column as Python values; bytes are decoded to text."""
    if column.dtype.kind == "S":
        # MAVLink text ends at the first NUL or the end of the field.
        return [value.split(b"\0", 1)[0].decode("utf-8", "replace") for value in column.tolist()]
    return list(column.tolist())


def _write_parquet(folder: Path, tables: Iterable[tuple[str, Table]]) -> None:
    pa, pq = import_extra("pyarrow"), import_extra("pyarrow.parquet")
    writers: dict[str, Any] = {}
    with ExitStack() as stack:
        for name, table in tables:
            arrays = {
                key: pa.array(
                    # Arrow needs contiguous arrays.
                    _python_values(column)
                    if column.dtype.kind == "S"
                    else np.ascontiguousarray(column)
                )
                for key, column in table.items()
            }
            part = pa.table(arrays)
            if name not in writers:
                writer = pq.ParquetWriter(
                    folder / f"{name}.parquet", part.schema, compression="zstd"
                )
                writers[name] = stack.enter_context(writer)
            writers[name].write_table(part)


def _write_mcap(path: Path, log: Path, recording: FlightData) -> None:
    """Write an MCAP file: Foxglove's views, a JSON channel per table, and the complete results."""
    foxglove = import_extra("foxglove")
    context = foxglove.Context()

    def channel(topic: str, schema: dict[str, Any]) -> Any:
        described = {"title": topic, "type": "object", **schema}
        return foxglove.Channel(topic, schema=described, context=context)

    @cache
    def results_of(kind: type) -> Any:
        return channel(f"/results/{kind.__name__}", msgspec.json.schema(kind))

    rows: dict[str, Any] = {}  # channels of tables
    with foxglove.open_mcap(path, allow_overwrite=True, context=context):
        write_views(recording, context)
        for name, stamps_ns, table in _timed_tables(log, recording):
            if name not in rows:
                kinds = {column: {"type": _json_type(values)} for column, values in table.items()}
                rows[name] = channel(f"/{name}", {"properties": kinds})
            for stamp, row in zip(stamps_ns, _json_rows(table), strict=True):
                rows[name].log(row, log_time=stamp)
        path = log / "results.jsonl"
        for result in read_results(path) if path.is_file() else ():
            results_of(type(result)).log(encode(result), log_time=max(result.t_us, 0) * 1000)


def _timed_tables(
    path: Path, recording: FlightData
) -> Iterator[tuple[str, NDArray[np.int64], Table]]:
    """Yield the messages with the times of their rows [ns] on the vehicle's clock.

    A tlog's times are those of the computer that wrote it. Tables without a time (parameters,
    formats) are at zero.
    """
    offset_ns = _clock_offset_ns(path, recording)
    for name, table in read_tables(path, with_results=False):
        time = next((table[key] for key in TIMES if key in table), None)
        rows = len(next(iter(table.values()), ()))
        stamps_ns = np.zeros(rows, np.int64) if time is None else time.astype(np.int64) * 1000
        # MCAP's times are unsigned.
        yield name, (stamps_ns - offset_ns).clip(0), table


def _clock_offset_ns(path: Path, recording: FlightData) -> int:
    """How far a tlog's clock is ahead of the vehicle's, by the first row of each message."""
    folder = [log for log in (path / "sent.tlog", path / "received.tlog") if log.is_file()]
    if not folder and is_autopilot_log(path):
        return 0
    ahead_ns = [
        int(rows["t_us"][0]) * 1000 - recording.t0_us * 1000 - round(float(known.t_s[0]) * 1e9)
        for name, rows in next(tlog.read_blocks((folder or [path])[0]), {}).items()
        if (known := recording.messages.get(name)) is not None and len(known.t_s)
    ]
    return int(np.median(ahead_ns)) if ahead_ns else 0


def _json_rows(table: Table) -> Iterator[dict[str, Any]]:
    """Yield rows; NaN and infinity, which JSON lacks, are None."""
    for row in zip(*map(_python_values, table.values()), strict=True):
        yield {
            key: None if isinstance(value, float) and not np.isfinite(value) else value
            for key, value in zip(table, row, strict=True)
        }


def _json_type(column: NDArray[Any]) -> str:
    if column.dtype.kind == "b":
        return "boolean"
    return "string" if column.dtype.kind in "SU" else "number"
