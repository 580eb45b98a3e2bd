"""The checkpoint of a search: what every evaluation came to, appended batch by batch.

Searchers depend only on their seed and on what they are told, so that fitness is all a resumed
search needs: it asks again and answers from here. A batch cut off by a kill is flown again.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError

# Little-endian on every machine: a search may go on on another one.
RECORD = np.dtype([("fitness", "<f8"), ("broken_limit", "<i4"), ("steps", "<i4")])
Records = NDArray[np.void]


class History:
    """The files `search.json` (what is searched) and `history.bin` in a folder."""

    def __init__(self, folder: Path, what: dict[str, Any]) -> None:
        """Open or begin a history.

        Raises
        ------
        ConfigError
            If the folder holds another search.
        """
        folder.mkdir(parents=True, exist_ok=True)
        key = folder / "search.json"
        text = json.dumps(what, indent=1, sort_keys=True)
        if key.exists() and key.read_text() != text:
            # Answers of another search would lead the searcher astray without a sign.
            raise ConfigError(f"{folder}: holds another search; give an empty folder to --out")
        key.write_text(text)
        self._path = folder / "history.bin"
        data = self._path.read_bytes() if self._path.exists() else b""
        # Only whole records: a kill may have cut the last one.
        self._known = np.frombuffer(data[: len(data) // RECORD.itemsize * RECORD.itemsize], RECORD)
        self._used = 0
        # "r+b" keeps what is there; "a" would not let a cut record be written over.
        self._file = self._path.open("r+b" if data else "w+b")

    @property
    def known_count(self) -> int:
        """Evaluations that were there when the history was opened."""
        return len(self._known)

    def recall(self, count: int) -> Records | None:
        """The next `count` records; None, from then on, where there are not as many."""
        if self._used + count > len(self._known):
            # What follows belongs to a batch that was cut off: from here on everything is flown.
            self._known = self._known[: self._used]
            return None
        self._used += count
        return self._known[self._used - count : self._used]

    def append(self, records: Records) -> None:
        """Write a batch behind what has been recalled or written; it is on disk on return."""
        self._file.seek(self._used * RECORD.itemsize)
        # Behind the last used record, whatever a killed search left there.
        self._file.truncate()
        self._file.write(records.tobytes())
        self._file.flush()
        self._used += len(records)
        # What was known is behind us: nothing may be recalled after something was written.
        self._known = self._known[:0] if self._used > len(self._known) else self._known

    def close(self) -> None:
        """Close the file."""
        self._file.close()
