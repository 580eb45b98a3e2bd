"""A time series from a CSV or Parquet file, for faults that a schedule cannot hold."""

import csv
import math
from array import array
from bisect import bisect_right
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec

from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.documents.extras import import_extra

MOST_READ = 16  # files kept in memory, which takes 16 bytes a row


class SeriesTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A series from a CSV or Parquet file; times in seconds from the start of the fault."""

    file: str
    time: str = "t_s"
    value: str = "value"
    interpolate: Literal["hold", "linear"] = "hold"


class Series(NamedTuple):
    """Increasing times [s] and their values; there is none before the first or after the last."""

    times_s: "array[float]"
    values: "array[float]"
    linear: bool

    def at(self, t_s: float) -> float | None:
        """Return the value at a time: of the latest row, or interpolated between two rows."""
        times_s, values = self.times_s, self.values
        k = bisect_right(times_s, t_s)
        if k == 0 or t_s > times_s[-1]:
            return None
        if k == len(times_s) or not self.linear:
            return values[k - 1]
        share = (t_s - times_s[k - 1]) / (times_s[k] - times_s[k - 1])
        return values[k - 1] + share * (values[k] - values[k - 1])


def read_series(table: SeriesTable) -> Series:
    """Read a series, or return it as it was read before, unless the file has changed.

    Raises
    ------
    ConfigError
        If the file cannot be read, lacks a column, contains text, or its times go back.
    """
    with users_path(f"{table.file}: cannot be read", "give a CSV or Parquet file"):
        return _read(table, Path(table.file).stat().st_mtime_ns)


@lru_cache(MOST_READ)
def _read(table: SeriesTable, _changed_ns: int) -> Series:
    times_s, values, last_s = array("d"), array("d"), -math.inf
    for t_s, value in (_parquet if table.file.endswith(".parquet") else _csv)(table):
        if not t_s > last_s or not math.isfinite(value):
            raise ConfigError(
                f"{table.file}: near {table.time} = {t_s} times do not increase or values are "
                "not finite; give increasing times and finite values"
            )
        times_s.append(t_s)
        values.append(value)
        last_s = t_s
    return Series(times_s, values, table.interpolate == "linear")


def _csv(table: SeriesTable) -> Iterator[tuple[float, float]]:
    with Path(table.file).open(newline="", encoding="utf-8") as file:
        rows = csv.reader(file)
        names = [name.strip() for name in next(rows, [])]
        time, value = _columns(names, table)
        try:
            for row in rows:
                if row:
                    yield float(row[time]), float(row[value])
        except (ValueError, IndexError) as error:
            place = f"{table.file}:{rows.line_num}"
            raise ConfigError(f"{place}: {error}; give two numbers in every row") from None


def _parquet(table: SeriesTable) -> Iterator[tuple[float, float]]:
    parquet = import_extra("pyarrow.parquet")
    try:
        _columns(parquet.read_schema(table.file).names, table)
        found = parquet.read_table(table.file, columns=[table.time, table.value])
        columns = (map(float, found[name].to_pylist()) for name in (table.time, table.value))
        yield from zip(*columns, strict=True)
    except (TypeError, ValueError) as error:
        if isinstance(error, ConfigError):  # which is a ValueError, but already complete
            raise
        raise ConfigError(f"{table.file}: {error}; give two numbers in every row") from None


def _columns(names: list[str], table: SeriesTable) -> tuple[int, int]:
    for name in (table.time, table.value):
        if name not in names:
            known = ", ".join(names)
            raise ConfigError(f"{table.file}:1: has no column {name}; known: {known}")
    return names.index(table.time), names.index(table.value)
