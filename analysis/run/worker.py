"""The monitor in a process of its own, so that a run uses two cores.

Bytes go to it by a pipe, results and the summary come back; the pipe's buffer bounds what waits.
"""

import multiprocessing
import signal
from collections.abc import Sequence
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

from analysis.criteria import Criteria
from analysis.pipeline import MonitorConfig
from analysis.results import Result
from mavproxy_fault.wire.label import Label

BATCH_BYTES = 32_768
Question = tuple[list[Label], Criteria, float]


def _work(pipe: Connection, config: MonitorConfig) -> None:
    """The process: bytes in, results out, until a question asks for the summary."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's: it still wants a summary
    from analysis.monitor import Monitor

    monitor = Monitor(config)
    while True:
        try:
            order = pipe.recv()
        except EOFError:
            return
        if isinstance(order, bytes):
            pipe.send(monitor.bytes(order, datagram=False))
        else:
            pipe.send(monitor.summary(*order))


class MonitorProcess:
    """A monitor to feed; it works on one batch while the caller makes the next."""

    def __init__(self, config: MonitorConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, config), daemon=True)
        self._process.start()
        theirs.close()
        self._batch = bytearray()
        self._working = False

    def __enter__(self) -> "MonitorProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pipe.close()
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.terminate()

    def feed(self, data: bytes, *, now: bool = False) -> list[Result]:
        """Hand on bytes, in batches unless `now`; the results of an earlier batch."""
        self._batch += data
        if not self._batch or (len(self._batch) < BATCH_BYTES and not now):
            return []
        results = self._collect()
        self._pipe.send(bytes(self._batch))
        self._batch.clear()
        self._working = True
        return results

    def results(self) -> list[Result]:
        """The results of what was fed, all of it."""
        return self.feed(b"", now=True) + self._collect()

    def summary(self, labels: Sequence[Label], criteria: Criteria, wall_s: float) -> dict[str, Any]:
        """The content of `summary.json`; after `results`."""
        self._pipe.send((list(labels), criteria, wall_s))
        summary: dict[str, Any] = self._pipe.recv()
        return summary

    def _collect(self) -> list[Result]:
        if not self._working:
            return []
        self._working = False
        results: list[Result] = self._pipe.recv()
        return results
