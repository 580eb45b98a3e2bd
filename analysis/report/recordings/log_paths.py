"""The files behind the paths a user gives: there, regular, and unpacked if they are compressed."""

import gzip
import lzma
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mavproxy_fault.documents.errors import ConfigError

PACKED = (".gz", ".xz", ".zst")
POINTER = b"version https://git-lfs.github.com/spec/"  # how a Git LFS pointer begins


def log_files(paths: Sequence[Path], folder: Path) -> tuple[list[Path], list[str]]:
    """Files and folders that can be read, and a message for each path that cannot.

    Parameters
    ----------
    paths : sequence of Path
        What the user gave.
    folder : Path
        Where compressed logs are unpacked to, under their names without the ending.

    Raises
    ------
    ConfigError
        If there is a single path and it cannot be read.
    """
    found, messages = [], []
    for path in paths:
        try:
            found.append(log_file(path, folder))
        except ConfigError as error:
            if len(paths) == 1:
                raise
            messages.append(str(error))
    return found, messages


def log_file(path: Path, folder: Path) -> Path:
    """The path itself, or that of the unpacked log.

    Raises
    ------
    ConfigError
        If nothing is there, or no log can be in it.
    """
    if not path.exists():
        raise ConfigError(f"{path}: there is no such file; give the path of a log")
    if path.is_dir():
        return path
    if not path.is_file():
        # A log is read more than once; a pipe only gives its bytes once.
        raise ConfigError(f"{path}: is a pipe or a device; give a file, which can be read twice")
    try:
        with path.open("rb") as file:
            pointer = file.read(len(POINTER)) == POINTER
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a log") from error
    if pointer:
        raise ConfigError(f"{path}: is a Git LFS pointer, not the log; run git lfs pull first")
    return _unpacked(path, folder) if path.suffix in PACKED else path


def _unpacked(path: Path, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / path.stem
    number = 1
    while target.exists():  # two folders may hold logs of one name
        number += 1
        target = folder / f"{number}-{path.stem}"
    try:
        with _reader(path) as source, target.open("wb") as file:
            # In blocks: logs may be larger than memory.
            shutil.copyfileobj(source, file, 1 << 22)
    except (OSError, EOFError, lzma.LZMAError) as error:
        raise ConfigError(f"{path}: cannot be unpacked ({error}); give a whole file") from error
    return target


def _reader(path: Path) -> Any:
    if path.suffix == ".gz":
        return gzip.open(path)
    if path.suffix == ".xz":
        return lzma.open(path)
    # Only for zstd, which Python's own library lacks here.
    import pyarrow as pa

    return pa.CompressedInputStream(str(path), "zstd")
