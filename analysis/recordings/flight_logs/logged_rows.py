"""The rows of an autopilot's own log as they were logged, block by block."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_BYTES = 1 << 25  # read at once, to limit memory

Rows = NDArray[np.void]  # of one message: offset in the file (`at`) and fields
Thin = Callable[[Rows], Rows]  # chooses the rows (k,) to keep of those (n,) of a message in a block
Topic = dict[str, NDArray[Any]]
BlockRows = Sequence[tuple[Any, Rows]]  # by key of the message


def join_rows(blocks: Iterable[BlockRows], thin: Thin | None = None) -> dict[Any, Rows]:
    """The rows of each message in some blocks, or those that `thin` chooses."""
    parts: dict[Any, list[Rows]] = {}
    for block in blocks:
        for key, rows in block:
            parts.setdefault(key, []).append(rows if thin is None else thin(rows))
    # Of a message whose format changes no rows can be joined.
    return {
        key: some[0] if len(some) == 1 else np.concatenate(some, dtype=some[0].dtype)
        for key, some in parts.items()
        if len({rows.dtype for rows in some}) == 1
    }


def gather_rows(
    data: NDArray[np.uint8],
    at: int,
    starts: NDArray[np.int64],
    dtype: np.dtype[np.void],
    width: int,
) -> Rows:
    """The rows of one message in a block that begins at `at` in the file: the place of each, and
    `width` bytes of fields, which begin at `starts` (n,); missing ones are zero."""
    rows = np.zeros(len(starts), dtype)
    # A sliding view, indexed at the messages only: nothing else is copied.
    windows = np.lib.stride_tricks.sliding_window_view(data, width)
    rows.view(np.uint8).reshape(len(starts), -1)[:, 8 : 8 + width] = windows[starts]
    rows["at"] = starts + at
    return rows
