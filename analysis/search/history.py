"""The checkpoint of a search: the result of every evaluation, appended batch by batch.

Searchers depend only on their seed and on the reported fitness, so a resumed search repeats its
queries and takes the fitness from here. A batch that was interrupted is flown again.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError

# Little-endian on every machine: a search may continue on another one.
RECORD = np.dtype([("fitness", "<f8"), ("broken_limit", "<i4"), ("steps", "<i4")])
Records = NDArray[np.void]


class History:
    """The files `search.json` (the test) and `history.bin` in a folder."""

    def __init__(self, folder: Path, what: dict[str, Any]) -> None:
        """Open or create a history.

        Raises
        ------
        ConfigError
            If the folder holds another search.
        """
        folder.mkdir(parents=True, exist_ok=True)
        key = folder / "search.json"
        text = json.dumps(what, indent=1, sort_keys=True)
        if key.exists() and key.read_text() != text:
            # Results of another search would mislead the searcher silently.
            raise ConfigError(f"{folder}: holds another search; give an empty folder to --out")
        key.write_text(text)
        self._path = folder / "history.bin"
        data = self._path.read_bytes() if self._path.exists() else b""
        # Only complete records: the last one may be cut off.
        self._known = np.frombuffer(data[: len(data) // RECORD.itemsize * RECORD.itemsize], RECORD)
        self._used = 0
        # "r+b" keeps the content; "a" could not overwrite an incomplete record.
        self._file = self._path.open("r+b" if data else "w+b")

    def recall(self, count: int) -> Records | None:
        """The next `count` records; None, from then on, if there are fewer."""
        if self._used + count > len(self._known):
            # The rest belongs to an incomplete batch: from here on everything is flown.
            self._known = self._known[: self._used]
            return None
        self._used += count
        return self._known[self._used - count : self._used]

    def append(self, records: Records) -> None:
        """Append a batch after the last one recalled or written; flushed on return."""
        self._file.seek(self._used * RECORD.itemsize)
        # After the last used record, over the remains of an interrupted batch.
        self._file.truncate()
        self._file.write(records.tobytes())
        self._file.flush()
        self._used += len(records)
        # Nothing may be recalled after a write.
        self._known = self._known[:0] if self._used > len(self._known) else self._known

    def close(self) -> None:
        """Close the file."""
        self._file.close()
