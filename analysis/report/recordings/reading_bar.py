"""Progress bar for reading large logs."""

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

SHOWN_BYTES = 50_000_000  # chosen: smaller logs need no progress bar

ReportProgress = Callable[[float], None]  # called with the share read so far, 0 to 1


@contextmanager
def reading_bar(path: Path) -> Iterator[ReportProgress]:
    """Show a progress bar; none for small logs, without a terminal, or in a worker process."""
    hidden = not sys.stderr.isatty() or multiprocessing.parent_process() is not None
    if hidden or path.stat().st_size < SHOWN_BYTES:
        yield lambda _: None
        return
    from analysis.work_progress import WorkProgress

    with WorkProgress(f"reading {path.name}", 100.0, "%") as progress:
        yield lambda share: progress.show(100.0 * share)
