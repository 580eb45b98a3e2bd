"""Files that are complete or absent even if their writer is killed, and files of one user."""

import os
from io import FileIO
from pathlib import Path

PRIVATE = 0o600  # for the user only
SHARED = 0o666  # minus the umask, as usual


def create_file(path: Path, mode: int = PRIVATE) -> FileIO:
    """Create a file for writing, unbuffered; a file or a link of that name is an error.

    Raises
    ------
    OSError
        If it exists or cannot be created.
    """

    def opener(name: str, flags: int) -> int:
        # A link planted under that name would lead elsewhere.
        return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0), mode)

    return FileIO(path, "x", opener=opener)


def replace_file(path: Path) -> FileIO:
    """Create a file in place of an earlier one, as `create_file` does; a link is an error."""
    # An earlier file may be readable for others, or be somebody else's.
    if path.is_file() and not path.is_symlink():
        path.unlink()
    return create_file(path)


def write_private(path: Path, data: bytes) -> None:
    """Write a file of this user alone, as `replace_file` does."""
    with replace_file(path) as file:
        write_all(file, data)


def write_atomic(path: Path, text: str, mode: int = SHARED) -> None:
    """Write a file so that a reader sees either the old or the new content."""
    # Renaming within a folder is atomic.
    fresh = path.with_name(path.name + ".new")
    fresh.unlink(missing_ok=True)
    # The text may quote file names, which may contain bytes that are not UTF-8.
    with create_file(fresh, mode) as file:
        write_all(file, text.encode(errors="backslashreplace"))
    fresh.replace(path)


def write_all(file: FileIO, data: bytes | bytearray) -> None:
    """Write all data; a nearly full disk accepts a part and raises at the next attempt."""
    # A memory view avoids copies of the rest.
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]
