"""The monitor in a process of its own, so that a run uses two cores.

Bytes go to it by a bounded queue, results come back by a pipe. The flight runs ahead while the
monitor compiles its kernels, and the monitor catches up. Where machine code is at hand the first
bytes have it loaded, before an autopilot needs both cores.
"""

import contextlib
import gc
import queue
import signal
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.queues import Queue
from pathlib import Path
from types import TracebackType
from typing import Any

from analysis.monitor.pipeline import MonitorConfig
from analysis.processes import fork_context, spawn_context
from analysis.results import Result
from analysis.run import kernel_precompilation
from analysis.scoring.criteria import Criteria
from mavproxy_fault.ardupilot.child_process import describe_exit, die_with_parent
from mavproxy_fault.wire.label import Label

FIRST_BYTES = 1 << 12  # then twice as many each time: a flight has time in its beginning
BATCH_BYTES = 1 << 19  # some 4,000 frames: in small blocks the monitor does more than reckon
MAX_QUEUED_BATCHES = 64  # 32 MB that the flight may be ahead
MonitorRequest = bytes | tuple[list[Label], Criteria, float]


def _run_monitor(
    orders: "Queue[MonitorRequest | None]",
    answers: Connection,
    config: MonitorConfig,
    records: bool,
) -> None:
    """The process: bytes in, results out; a question is answered by the summary."""
    # Without this a killed run would leave the monitor behind.
    die_with_parent()
    gc.freeze()  # what is loaded stays; to look it through would copy a fork's pages
    from analysis.monitor.monitor import Monitor

    monitor = Monitor(config)
    while (order := orders.get()) is not None:
        # Bytes are work, a tuple asks for the summary, None ends.
        if isinstance(order, bytes) and records:
            answers.send(monitor.push_records(order))
        elif isinstance(order, bytes):
            answers.send(monitor.push_bytes([order], datagrams=False))
        else:
            answers.send(monitor.summary(*order))


class MonitorDiedError(RuntimeError):
    """The monitor's process ended before its work did."""


def _precompile(config: MonitorConfig, mark: Path) -> None:
    die_with_parent()
    kernel_precompilation.precompile_kernels(config, mark)


@contextlib.contextmanager
def _block_signals(*signals: signal.Signals) -> Iterator[None]:
    """Signals are the parent's, who still wants a summary: what is started inherits the mask."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows has no signals to mask
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class MonitorProcess:
    """A monitor to feed; it works on what it was given while the caller makes more.

    It is fed frames, or with `records` whole records of a log, which it reads sooner.
    """

    def __init__(self, config: MonitorConfig, *, records: bool = False) -> None:
        context = fork_context() or spawn_context()
        self._orders: Queue[MonitorRequest | None] = context.Queue(MAX_QUEUED_BATCHES)
        self._answers, theirs = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_run_monitor, args=(self._orders, theirs, config, records), daemon=True
        )
        # Only the first run after an installation compiles.
        mark = kernel_precompilation.pending_marker()
        with _block_signals(signal.SIGINT):
            if mark is not None:
                context.Process(target=_precompile, args=(config, mark), daemon=True).start()
            with _block_signals(signal.SIGTERM):
                self._process.start()
        # Only the child holds it then, so that its death is seen as the end of the pipe.
        theirs.close()
        self.pid = self._process.pid or 0
        self._batch, self._enough = bytearray(), FIRST_BYTES
        self.pending_batches = 0  # batches without their results yet

    def __enter__(self) -> "MonitorProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # After an error nobody wants results: no waiting.
        if kind is not None:
            self._process.kill()
            # Or the queue's thread would wait for a reader that is gone.
            self._orders.cancel_join_thread()
        else:
            self._orders.put(None)
        self._orders.close()
        self._process.join()
        self._answers.close()

    def feed(self, data: bytes, *, now: bool = False) -> list[Result]:
        """Hand on bytes, in batches unless `now`; the results that are there by then."""
        self._batch += data
        results: list[Result] = []
        # Results are looked for with each batch: to ask costs more than to gather a step's bytes.
        if len(self._batch) < self._enough and not now:
            return results
        self._enough = min(2 * self._enough, BATCH_BYTES)
        if self._batch:
            batch = bytes(self._batch)
            self._batch.clear()
            # Both queues are bounded: without taking results here, two full ones would wait for
            # each other.
            while not self._handed_on(batch):
                results += self._receive()
            self.pending_batches += 1
        while self.pending_batches and self._answers.poll():
            results += self._receive()
        return results

    def results(self) -> list[Result]:
        """The results of all that was fed; waits for them."""
        results = self.feed(b"", now=True)
        while self.pending_batches:
            results += self._receive()
        return results

    def summary(self, labels: Sequence[Label], criteria: Criteria, wall_s: float) -> dict[str, Any]:
        """The content of `summary.json`; after `results`."""
        self._orders.put((list(labels), criteria, wall_s))
        summary: dict[str, Any] = self._answer()
        return summary

    def _handed_on(self, batch: bytes) -> bool:
        try:
            self._orders.put_nowait(batch)
        except queue.Full:
            return False
        return True

    def _receive(self) -> list[Result]:
        """The oldest results owed."""
        results: list[Result] = self._answer()
        self.pending_batches -= 1
        return results

    def _answer(self) -> Any:
        """What the process sent; MonitorDiedError if it is no more."""
        try:
            return self._answers.recv()
        except EOFError:
            # Joined first: the exit code is known only then.
            self._process.join()
            how = describe_exit(self._process.exitcode or 0)
            raise MonitorDiedError(f"the monitor's process ended {how}") from None
