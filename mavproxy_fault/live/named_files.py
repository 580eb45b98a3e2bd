"""Access check for files named in live requests: only folders given by --files are allowed."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mavproxy_fault.documents.errors import ConfigError

LARGEST_BYTES = 256 << 20  # chosen: far above any table that a schedule needs


def check_files(data: Any, folders: Sequence[Path] | None, where: str) -> None:
    """Refuse an entry or a schedule that names a file outside `folders`; None allows any file.

    Raises
    ------
    ConfigError
        If a file is in none of the folders, or too large. The text reveals none of its content.
    """
    for name in _files(data) if folders is not None else ():
        # Resolved first, so that `..` and links cannot leave the folders.
        path = Path(name).resolve()
        if not any(path.is_relative_to(folder.resolve()) for folder in folders or ()):
            raise ConfigError(
                f"{where}: {name} must not be named in a request; allowed: files below the folders "
                "given to the proxy by --files DIR"
            )
        if not path.is_file() or path.stat().st_size > LARGEST_BYTES:
            raise ConfigError(
                f"{where}: {name} is not a file of at most {LARGEST_BYTES >> 20} MiB; give another"
            )


def _files(data: Any) -> Iterator[str]:
    """Yield every value under a key `file` at any depth."""
    # Without recursion, since the sender chooses the depth.
    waiting = [data]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            yield from (str(value) for key, value in one.items() if key == "file")
            waiting += one.values()
        elif isinstance(one, list):
            waiting += one
