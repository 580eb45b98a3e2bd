"""A time series from a CSV or Parquet file, read in blocks to bound the memory.

This is the only fault that reads a file: a series of hours does not fit a schedule and would take
hundreds of megabytes in memory. Only the current block is kept.
"""

import csv
import itertools
import logging
import math
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra

BLOCK_ROWS = 8192
LOG = logging.getLogger(__name__)
Block = tuple[tuple[float, ...], tuple[float, ...]]  # times in seconds, and values


class SeriesTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A series from a CSV or Parquet file; times in seconds from the start of the fault."""

    file: str
    time: str = "t_s"
    value: str = "value"
    interpolate: Literal["hold", "linear"] = "hold"


class Series:
    """Looks up values at increasing times; a step back in time rereads the file.

    There is no value before the first row or after the last.
    """

    def __init__(self, table: SeriesTable) -> None:
        self.table = table
        self._start()

    def _start(self) -> None:
        self._blocks = read_blocks(self.table)
        self._times: tuple[float, ...] = ()
        self._values: tuple[float, ...] = ()
        self._at = 0  # earlier rows are no longer needed
        self._previous: tuple[float, float] | None = None
        self._latest_s = -math.inf

    def _next(self) -> Block | None:
        """Read the next block; an invalid series ends there, since traffic must continue."""
        try:
            return next(self._blocks, None)
        except ConfigError as error:
            LOG.warning("the series is cut off at an error: %s", error)
            return None

    def at(self, t_s: float) -> float | None:
        """Return the value at a time: of the latest row, or interpolated between two rows."""
        # The reader only goes forward and restarts when time goes back.
        if t_s < self._latest_s:
            self._start()
        self._latest_s = t_s
        while not len(self._times) or t_s >= self._times[-1]:
            block = self._next()
            if block is None:
                # The last row is valid at its own time only.
                if len(self._times) and t_s == self._times[-1]:
                    return self._values[-1]
                return None
            if len(self._times):
                # Interpolation between two blocks needs the last row of the older one.
                self._previous = (self._times[-1], self._values[-1])
            self._times, self._values = block
            self._at = 0
        # Times increase, so the search continues from the last row.
        k = bisect_right(self._times, t_s, self._at)
        self._at = k
        if k > 0:
            before = (self._times[k - 1], self._values[k - 1])
        elif self._previous is not None:
            before = self._previous
        else:
            return None
        if self.table.interpolate == "hold":
            return before[1]
        share = (t_s - before[0]) / (self._times[k] - before[0])
        return before[1] + share * (self._values[k] - before[1])


def read_blocks(table: SeriesTable) -> Iterator[Block]:
    """Yield the rows of a series in blocks of at most `BLOCK_ROWS`.

    Raises
    ------
    ConfigError
        If the file cannot be read, lacks a column, contains text, or its times go back.
    """
    last_s = -math.inf
    source = _parquet if Path(table.file).suffix == ".parquet" else _csv
    for times, values in source(table):
        # Includes the last time of the previous block, to check the joint.
        ascending = all(a < b for a, b in itertools.pairwise((last_s, *times)))
        if not ascending or not all(map(math.isfinite, values)):
            raise ConfigError(
                f"{table.file}: near {table.time} = {times[0]} times do not increase or values are "
                "not finite; give increasing times and finite values"
            )
        last_s = times[-1]
        yield times, values


def _csv(table: SeriesTable) -> Iterator[Block]:
    try:
        with Path(table.file).open(newline="", encoding="utf-8") as file:
            rows = csv.reader(file)
            names = [name.strip() for name in next(rows, [])]
            time, value = (_column(names, name, table.file) for name in (table.time, table.value))
            pairs = ((float(row[time]), float(row[value])) for row in rows if row)
            while block := list(itertools.islice(pairs, BLOCK_ROWS)):
                times, values = zip(*block, strict=True)
                yield times, values
    except OSError as error:
        raise ConfigError(f"{table.file}: cannot be read ({error}); give a CSV file") from None
    except (ValueError, IndexError) as error:
        # `ConfigError` is a ValueError, but already complete.
        if isinstance(error, ConfigError):
            raise
        line = rows.line_num
        raise ConfigError(f"{table.file}:{line}: {error}; give two numbers in every row") from None


def _column(names: list[str], name: str, file: str) -> int:
    if name not in names:
        raise ConfigError(f"{file}:1: has no column {name}; known: {', '.join(names)}")
    return names.index(name)


def _parquet(table: SeriesTable) -> Iterator[Block]:
    parquet = import_extra("pyarrow.parquet")

    try:
        with parquet.ParquetFile(table.file) as file:
            for name in (table.time, table.value):
                _column(file.schema_arrow.names, name, table.file)
            # Read two columns only.
            for batch in file.iter_batches(BLOCK_ROWS, columns=[table.time, table.value]):
                if batch.num_rows:
                    times, values = (
                        tuple(map(float, batch.column(name).to_pylist()))
                        for name in (table.time, table.value)
                    )
                    yield times, values
    except OSError as error:
        raise ConfigError(f"{table.file}: cannot be read ({error}); give Parquet") from None
    except (TypeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{table.file}: {error}; give two numbers in every row") from None
