"""How much of a file was ever written: loggers may reserve space that they never fill."""

import os
from errno import ENXIO
from pathlib import Path


def written_bytes(path: Path) -> int:
    """The file's length without a hole at its end; the whole length where holes are not told."""
    size = path.stat().st_size
    if not hasattr(os, "SEEK_DATA"):  # Windows
        return size
    end = 0
    with path.open("rb") as file:
        try:
            while end < size:
                data = os.lseek(file.fileno(), end, os.SEEK_DATA)
                end = os.lseek(file.fileno(), data, os.SEEK_HOLE)
        except OSError as error:
            # ENXIO: no data behind this place. Anything else: a file system without an answer.
            return end if error.errno == ENXIO else size
    return size
