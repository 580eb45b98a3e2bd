"""Pack every field of every message for the page's search box, one message at a time.

The page unpacks a message when one of its fields is plotted. Within the file, messages are thinned
to fit the size; beside it (`report-data/`) they are complete, as scripts that pass their numbers to
the page.
"""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from analysis.report.curves.recording import Message, Vector, element_columns
from analysis.report.page.packed_numbers import PackedNumbers
from mavproxy_fault.documents.errors import ConfigError

# The value of `--data` that writes the numbers beside the page, in place of a size in MB.
BESIDE = "beside"
INSIDE_MB = 2.0
FOLDER = "report-data"
BYTES_OF_A_CELL = 2.5  # of a float32, deflated and base64-coded; 1.5 to 4 in real logs
LONGEST_ARRAY = 16  # elements of an array field
OFFSET_ABOVE = 1e6  # larger numbers are stored as differences to the first


@dataclass(frozen=True, slots=True)
class FieldData:
    """Fields in the page: an index, and packed numbers by message number."""

    index: list[dict[str, Any]] = field(default_factory=list)
    inside: dict[int, str] = field(default_factory=dict)


def field_data(messages: Mapping[str, Message], where: str, folder: Path) -> FieldData:
    """Pack the fields of all messages (by name).

    `where` is "beside", which writes them to `report-data` in the report's `folder`, or their size
    limit within the page in MB; anything else raises ConfigError.
    """
    most_mb = None if where == BESIDE else _megabytes(where)
    # `--data 0`: no fields, and no search box.
    if most_mb == 0:
        return FieldData()
    # Sorted, so that message numbers are reproducible.
    tables = [(name, m) for name, m in sorted(messages.items()) if len(m.t_s)]
    # + 1: the times are a column too.
    sizes = [(len(m.t_s), sum(1 for _ in _columns(m, len(m.t_s))) + 1) for _, m in tables]
    most_rows = None if most_mb is None else _rows(sizes, most_mb * 1e6 / BYTES_OF_A_CELL)
    found = FieldData()
    for number, (name, message) in enumerate(tables):
        entry, text = _packed(message, most_rows)
        found.index.append({"name": name, "number": number, "rows": len(message.t_s)} | entry)
        if most_mb is not None:
            found.inside[number] = text
            continue
        beside = folder / FOLDER / f"{number}.js"
        beside.parent.mkdir(exist_ok=True)
        # A script, since a page opened as a file can load scripts but not fetch data.
        beside.write_text(f'report.fields.arrived({number},"{text}");\n', encoding="ascii")
    return found


def _megabytes(where: str) -> float:
    try:
        size = float(where)
    # Not a number: rejected below.
    except ValueError:
        size = -1.0
    if not 0 <= size < float("inf"):
        raise ConfigError(f"--data {where}: is not a size; give MB or {BESIDE!r}")
    return size


def _rows(sizes: list[tuple[int, int]], cells: float) -> int:
    """The row limit per message that keeps the total within `cells`."""
    # The number of cells increases with the limit.
    limits = range(2, max((rows for rows, _ in sizes), default=2) + 1)
    fits = bisect_right(
        limits, cells, key=lambda most: sum(min(rows, most) * columns for rows, columns in sizes)
    )
    return limits[max(fits - 1, 0)]


def _columns(message: Message, step: int) -> Iterator[tuple[str, Vector]]:
    """Every `step`-th row of numeric fields, of array fields by their elements; constant zeros are
    kept. A message of texts only shows when it came."""
    shown = False
    for name, column in message.columns.items():
        # The times are the axis of every field.
        if name in ("timestamp", "TimeUS") or column.dtype.kind not in "iufb":
            continue
        shown = True
        for element, values in element_columns(name, column[::step], LONGEST_ARRAY):
            yield element, values.astype(float)
    if not shown:
        yield "count", np.arange(1.0, len(message.t_s) + 1)[::step]


def _packed(message: Message, most_rows: int | None) -> tuple[dict[str, Any], str]:
    """One message's index entry and packed numbers; a thinned message keeps every `step`-th row."""
    # Rounded up, so that no message exceeds the limit.
    step = 1 if most_rows is None else max(1, -(-len(message.t_s) // most_rows))
    numbers = PackedNumbers()
    entry: dict[str, Any] = {"step": step, "t": numbers.add_times(message.t_s[::step])}
    entry["fields"] = []
    for name, values in _columns(message, step):
        # GPS microseconds or 1e-7 degrees would lose digits in float32; differences to the first
        # value keep them.
        first = next(
            (v for v in values[:1].tolist() if np.isfinite(v) and abs(v) > OFFSET_ABOVE), 0.0
        )
        place = numbers.add_values(values - first)
        entry["fields"].append({"name": name, "y": place, "add": first})
    return entry, numbers.text()
