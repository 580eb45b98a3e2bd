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
        self._file = (folder / "history.bin").open("a+b")
        self._file.seek(0)
        data = self._file.read()
        # Only complete records: the last one may be cut off.
        self._known = np.frombuffer(data[: len(data) // RECORD.itemsize * RECORD.itemsize], RECORD)
        self._keep(self._known.nbytes)

    def _keep(self, size: int) -> None:
        self._file.truncate(size)
        self._file.seek(size)

    def recall(self, count: int) -> Records | None:
        """The next `count` records; None, from then on, if there are fewer."""
        records, self._known = self._known[:count], self._known[count:]
        if len(records) == count:
            return records
        # These belong to an incomplete batch: from here on everything is flown.
        self._keep(self._file.tell() - records.nbytes)
        return None

    def append(self, records: Records) -> None:
        """Append a batch that was not recalled; flushed on return."""
        self._file.write(records.tobytes())
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
