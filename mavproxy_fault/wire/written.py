"""Written length of a file: loggers may preallocate space that they never fill."""

import os
from errno import ENXIO
from pathlib import Path


def written_bytes(path: Path) -> int:
    """Return the file's length without a hole at its end, if the file system reports holes."""
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
            # ENXIO: no data after this offset. Other errors: the file system cannot report holes.
            return end if error.errno == ENXIO else size
    return size
