"""MAVLink messages to samples, by the field map."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.field_map import TLOG, Columns, chosen_rows, rows_of
from analysis.samples import block
from analysis.samples.block import SPARE, BlockPart, Indices

FIX_3D = 3  # GPS_FIX_TYPE
# The samples that each message gives.
SAMPLE_LINES = {
    name: samples
    for name, lines in TLOG.items()
    if (samples := [line for line in lines if line.target[0].isupper()])
}
# Fields with the time, and their microseconds.
TIMES = (("time_usec", 1), ("usec", 1), ("time_boot_ms", 1000))


def read_samples(name: str, rows: NDArray[Any], order: Indices) -> Iterator[BlockPart]:
    """The samples in the rows (n,) of a message; `order` (n,) are the rows' sort keys."""
    every = _columns(rows)
    for line in SAMPLE_LINES.get(name, ()):
        chosen = chosen_rows(line, every)
        if chosen is not None and not len(chosen):
            continue
        fields = every
        if chosen is not None and len(chosen) < len(rows):
            fields = _columns(rows.take(chosen))  # a tenth of the time of rows[chosen]
        values = rows_of(line, fields)
        if values is None:
            continue
        # `IMU#1` is a redundant sensor, for voting.
        kind, _, number = line.target.partition("#")
        if number:
            known = np.full((len(values), 2), (getattr(block, kind), int(number)), float)
            values = np.column_stack([known, values])
        key, scale = next(time for time in TIMES if time[0] in every)
        at = order if chosen is None else order[chosen]
        row_kind = SPARE if number else getattr(block, kind)
        yield BlockPart(row_kind, at, fields[key].astype(np.int64) * scale, values)


def _columns(rows: NDArray[Any]) -> Columns:
    return {name: rows[name] for name in rows.dtype.names or ()}
