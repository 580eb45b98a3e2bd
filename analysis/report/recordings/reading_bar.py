"""How far the reading of a large log is, on a terminal."""

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

SHOWN_BYTES = 50_000_000  # a smaller log is read before anybody looks

ReportProgress = Callable[[float], None]  # the share that is read, 0 to 1


@contextmanager
def reading_bar(path: Path) -> Iterator[ReportProgress]:
    """A bar while a log is read; nothing of small logs, without a terminal, and in a worker."""
    quiet = not sys.stderr.isatty() or multiprocessing.parent_process() is not None
    if quiet or path.stat().st_size < SHOWN_BYTES:
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"reading {path.name}", total=1.0)
        yield lambda share: progress.update(task, completed=share)
