"""Read the bytes of a receiver's log, compressed with gzip or not."""

import gzip
import zlib
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError


def read_log_bytes(path: Path, called: str) -> bytes:
    """The bytes of a log; `called` says in errors what it should be: "a u-blox log".

    Raises
    ------
    ConfigError
        If it cannot be read or decompressed.
    """
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if path.name.lower().endswith(".gz") else data
    except (EOFError, OSError, zlib.error) as error:
        raise ConfigError(f"{path}: not {called} ({error}); give a complete one") from error
