"""The rows of an autopilot's own log as they were logged, block by block."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.log_time import RowStamps

BLOCK_BYTES = 1 << 25  # read at once, to limit memory

Rows = NDArray[np.void]  # of one message: offset in the file (`at`) and fields
Thin = Callable[[Rows], Rows]  # chooses the rows (k,) to keep of those (n,) of a message in a block
Topic = dict[str, NDArray[Any]]
BlockRows = Sequence[tuple[Any, Rows]]  # by key of the message


class LoggedRows(Protocol):
    """A log of one format; it can be read several times."""

    def blocks(self) -> Iterator[BlockRows]:
        """The rows of each block."""

    def stamps(self, key: Any, rows: Rows) -> RowStamps:
        """Places and stamps of the rows of a message."""

    def topics(
        self, key: Any, rows: Rows, t_us: NDArray[np.int64]
    ) -> Iterator[tuple[tuple[str, int], Topic]]:
        """The columns of a message's rows with their times `t_us`, by name and instance."""


def join_rows(blocks: Iterable[BlockRows], thin: Thin | None = None) -> dict[Any, Rows]:
    """The rows of each message in some blocks, or those that `thin` chooses."""
    parts: dict[Any, list[Rows]] = {}
    for block in blocks:
        for key, rows in block:
            parts.setdefault(key, []).append(rows if thin is None else thin(rows))
    # Of a message whose format changes no rows can be joined.
    return {
        key: some[0] if len(some) == 1 else np.concatenate(some)
        for key, some in parts.items()
        if len({rows.dtype for rows in some}) == 1
    }
