"""Open the paths that a user gives: check that they are readable, and unpack compressed logs."""

import gzip
import lzma
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.documents.extras import import_extra

PACKED = (".gz", ".xz", ".zst")
POINTER = b"version https://git-lfs.github.com/spec/"  # beginning of a Git LFS pointer


def log_files(paths: Sequence[Path], folder: Path) -> tuple[list[Path], list[str]]:
    """The readable files and folders, and an error message for each other path.

    Compressed logs are unpacked to `folder`, under their names without the suffix. If the only
    path cannot be read, ConfigError is raised.
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
    """The path, or the path of the unpacked log if `path` is compressed.

    Raises
    ------
    ConfigError
        If the path does not exist, or cannot be a log.
    """
    if not path.exists():
        raise ConfigError(f"{path}: there is no such file; give the path of a log")
    if path.is_dir():
        return path
    if not path.is_file():
        # A log is read more than once, which a pipe does not allow.
        raise ConfigError(f"{path}: is a pipe or a device; give a file, which can be read twice")
    with users_path(path, "give the path of a log"), path.open("rb") as file:
        pointer = file.read(len(POINTER)) == POINTER
    if pointer:
        raise ConfigError(f"{path}: is a Git LFS pointer, not the log; run git lfs pull first")
    return _unpacked(path, folder) if path.suffix in PACKED else path


def _unpacked(path: Path, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / path.stem
    number = 1
    while target.exists():  # logs of different folders may have one name
        number += 1
        target = folder / f"{number}-{path.stem}"
    try:
        with _reader(path) as source, target.open("wb") as file:
            # Block by block: logs may be larger than memory.
            shutil.copyfileobj(source, file, 1 << 22)
    except (OSError, EOFError, lzma.LZMAError) as error:
        raise ConfigError(f"{path}: cannot be unpacked ({error}); give a complete file") from error
    return target


def _reader(path: Path) -> Any:
    if path.suffix == ".gz":
        return gzip.open(path)
    if path.suffix == ".xz":
        return lzma.open(path)
    # For zstd, which the standard library lacks.
    return import_extra("pyarrow").CompressedInputStream(str(path), "zstd")
