"""The run folder, which holds logs, results, summary and report of a run."""

import itertools
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from analysis.results import Result, encode_lines
from mavproxy_fault.documents.atomic_file import replace_file, write_all, write_atomic
from mavproxy_fault.documents.errors import ConfigError, users_path


def numbered_folder(name: str) -> Path:
    """Return `runs/NAME-1`, or the first number that is free."""
    folders = (Path("runs") / f"{name}-{number}" for number in itertools.count(1))
    return next(folder for folder in folders if not folder.exists())


def make_folder(out: str | None, name: str) -> Path:
    """Create the folder `out`, or the next free `runs/0001-name`; never overwrites an earlier run.

    Raises
    ------
    ConfigError
        If `out` holds an earlier run, or cannot be created.
    """
    if out is not None:
        folder, where, cure = Path(out), f"--out {out}", "give a writable folder"
        # A run that was killed has a log but no summary.
        if (folder / "summary.json").exists() or (folder / "received.tlog").exists():
            raise ConfigError(f"{where}: the folder holds an earlier run; give another folder")
    else:
        # A number is used only once, whatever the name.
        numbers = (f"{number:04d}-" for number in itertools.count(1))
        free = next(number for number in numbers if not any(Path("runs").glob(f"{number}*")))
        folder = Path("runs") / f"{free}{name}"
        where, cure = str(folder), "give a writable folder with --out"
    with users_path(where, cure):
        folder.mkdir(parents=True, exist_ok=out is not None)
    return folder


class ResultFile:
    """Writes `results.jsonl`, one result per line; written lines survive a kill of the process."""

    def __init__(self, folder: Path) -> None:
        self._file = replace_file(folder / "results.jsonl")

    def __enter__(self) -> "ResultFile":
        return self

    def __exit__(self, *raised: object) -> None:
        self._file.close()

    def write(self, results: Iterable[Result]) -> None:
        """Append results."""
        write_all(self._file, encode_lines(results))


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write `summary.json`; non-finite numbers become null."""
    text = json.dumps(replace_nonfinite(summary), indent=2, allow_nan=False)
    write_atomic(folder / "summary.json", text + "\n")


def replace_nonfinite(value: Any) -> Any:
    """Replace non-finite numbers, which JSON lacks, by None, recursively."""
    if isinstance(value, Mapping):
        return {key: replace_nonfinite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_nonfinite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
