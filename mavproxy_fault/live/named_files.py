"""Files that a request names: only those of folders that whoever started the proxy allowed."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mavproxy_fault.documents.errors import ConfigError

LARGEST_BYTES = 256 << 20


def check_files(data: Any, folders: Sequence[Path] | None, where: str) -> None:
    """Refuse an entry or a schedule, as data, that names a file it may not; None allows all.

    Raises
    ------
    ConfigError
        If a file lies in none of the folders, or is too large. Nothing of its content is told.
    """
    for name in _files(data) if folders is not None else ():
        # Resolved first: `..` and links must not lead out of the folders.
        path = Path(name).resolve()
        if not any(path.is_relative_to(folder.resolve()) for folder in folders or ()):
            raise ConfigError(
                f"{where}: {name} must not be named over the bus; allowed: files of the folders "
                "that the proxy was started with (--files DIR)"
            )
        if not path.is_file() or path.stat().st_size > LARGEST_BYTES:
            raise ConfigError(
                f"{where}: {name} is no file of at most {LARGEST_BYTES >> 20} MiB; give another"
            )


def _files(data: Any) -> Iterator[str]:
    """Every value under a key `file`, however deep."""
    # Without recursion: the depth of a payload is the sender's choice.
    waiting = [data]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            yield from (str(value) for key, value in one.items() if key == "file")
            waiting += one.values()
        elif isinstance(one, list):
            waiting += one
