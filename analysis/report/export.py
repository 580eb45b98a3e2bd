"""Export logs as tables: CSV or Parquet (one file per message), or one MCAP file.

A column is a field as the log names it; arrays become columns `name[0]`, `name[1]`, ... Times are
in microseconds as in the log.
"""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.dataflash import HEAD, is_dataflash, read_dataflash
from analysis.recordings.flight_logs.ulog import is_ulog, read_ulog
from analysis.results import encode, read_results
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.wire import tlog

Table = dict[str, NDArray[Any]]
# Time columns of tlog, ULog and dataflash; the first that exists is used.
TIMES = ("t_us", "timestamp", "TimeUS")


def export_tables(paths: Sequence[Path], folder: Path, form: str) -> None:
    """Write the tables of logs (or of a run folder) to `folder` as csv, parquet or mcap.

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
            _write_mcap(target / f"{path.stem}.mcap", path)
            continue
        for name, table in read_tables(path):
            if form == "csv":
                _write_csv(target / f"{name}.csv", table)
            else:
                _write_parquet(target / f"{name}.parquet", table)


def read_tables(path: Path, *, with_results: bool = True) -> Iterator[tuple[str, Table]]:
    """Read all tables of a log or run folder; yields name and columns."""
    if path.is_dir():
        for name in ("received", "sent"):
            if (path / f"{name}.tlog").is_file():
                for message, table in read_tables(path / f"{name}.tlog"):
                    yield f"{name}.{message}", table
        if with_results:
            yield from _result_tables(path / "results.jsonl")
        return
    # Formats are recognised by their first bytes, as logs are often renamed.
    with path.open("rb") as file:
        head = file.read(HEAD)
    if is_dataflash(head):
        for (name, instance), topic in read_dataflash(path).topics.items():
            yield f"{name}_{instance}", topic
        return
    if is_ulog(head):
        for (name, instance), topic in read_ulog(path).topics.items():
            yield f"{name}_{instance}", dict(topic)
        return
    for name, rows in tlog.read_columns(path).items():
        yield name, _flat(rows)


def _flat(rows: NDArray[np.void]) -> Table:
    table: Table = {}
    for name in rows.dtype.names or ():
        column = rows[name]
        # Many tools cannot read array cells, so each element gets a column.
        if column.ndim == 1:
            table[name] = column
        else:
            table.update({f"{name}[{i}]": column[:, i] for i in range(column.shape[1])})
    return table


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


def _write_csv(path: Path, table: Table) -> None:
    columns = [_python_values(column) for column in table.values()]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*columns, strict=True))


def _python_values(column: NDArray[Any]) -> list[Any]:
    """Column as Python values; bytes are decoded to text."""
    if column.dtype.kind == "S":
        # MAVLink text ends at the first NUL or the end of the field.
        return [value.split(b"\0", 1)[0].decode("utf-8", "replace") for value in column.tolist()]
    return list(column.tolist())


def _write_parquet(path: Path, table: Table) -> None:
    pa, pq = import_extra("pyarrow"), import_extra("pyarrow.parquet")

    arrays = {
        name: pa.array(
            # Arrow needs contiguous arrays.
            _python_values(column) if column.dtype.kind == "S" else np.ascontiguousarray(column)
        )
        for name, column in table.items()
    }
    pq.write_table(pa.table(arrays), path, compression="zstd")


def _write_mcap(path: Path, log: Path) -> None:
    """Write an MCAP file with one channel of JSON messages per table."""
    mcap = import_extra("mcap.writer")

    with path.open("wb") as file:
        writer = mcap.Writer(file, compression=mcap.CompressionType.ZSTD)
        writer.start(profile="", library="mavproxy-fault")
        for name, table in read_tables(log, with_results=False):
            _write_channel(writer, name, table)
        _write_results(writer, log / "results.jsonl")
        writer.finish()


def _write_channel(writer: Any, name: str, table: Table) -> None:
    properties = {column: {"type": _json_type(values)} for column, values in table.items()}
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    schema_id = writer.register_schema(name, "jsonschema", schema)
    channel = writer.register_channel(f"/{name}", "json", schema_id)
    time = next((key for key in TIMES if key in table), None)
    columns = [_python_values(column) for column in table.values()]
    # MCAP uses nanoseconds; tables without a time (parameters, formats) are at zero.
    stamps = table[time].astype(np.int64) * 1000 if time else np.zeros(len(columns[0]), np.int64)
    for stamp, row in zip(stamps.tolist(), zip(*columns, strict=True), strict=True):
        values = {key: _finite(value) for key, value in zip(table, row, strict=True)}
        data = json.dumps(values, allow_nan=False).encode()
        # MCAP timestamps are unsigned.
        writer.add_message(channel, log_time=max(stamp, 0), data=data, publish_time=max(stamp, 0))


def _write_results(writer: Any, path: Path) -> None:
    """Write complete results as in `results.jsonl`, one channel per type under `/results`."""
    if not path.is_file():
        return
    channels: dict[str, int] = {}
    for result in read_results(path):
        kind = type(result).__name__
        if kind not in channels:
            schema = json.dumps(msgspec.json.schema(type(result))).encode()
            schema_id = writer.register_schema(kind, "jsonschema", schema)
            channels[kind] = writer.register_channel(f"/results/{kind}", "json", schema_id)
        time_ns = max(result.t_us, 0) * 1000
        writer.add_message(
            channels[kind], log_time=time_ns, data=encode(result), publish_time=time_ns
        )


def _json_type(column: NDArray[Any]) -> str:
    if column.dtype.kind == "b":
        return "boolean"
    return "string" if column.dtype.kind in "SU" else "number"


def _finite(value: Any) -> Any:
    """Replace NaN and infinity, which JSON lacks, by None."""
    return None if isinstance(value, float) and not np.isfinite(value) else value
