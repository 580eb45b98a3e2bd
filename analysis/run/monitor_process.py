"""Run the monitor in its own process, so that a run uses two cores.

A bounded queue carries bytes to it, a pipe returns results. The flight runs ahead while the monitor
compiles its kernels, and the monitor catches up. If the kernels are already compiled, the first
bytes load them, before an autopilot needs both cores.
"""

import contextlib
import gc
import queue
import signal
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.queues import Queue
from types import TracebackType
from typing import Any

from analysis.monitor.pipeline import MonitorConfig
from analysis.processes import fork_context, spawn_context
from analysis.results import Result
from analysis.scoring.criteria import Criteria
from mavproxy_fault.ardupilot.child_process import describe_exit, die_with_parent
from mavproxy_fault.wire.label import Label

FIRST_BYTES = 1 << 12  # doubled for each batch, so that kernels load early in the flight
BATCH_BYTES = 1 << 19  # about 4,000 frames: small blocks have more overhead than computation
MAX_QUEUED_BATCHES = 64  # 32 MB by which the flight may be ahead
MonitorRequest = bytes | tuple[list[Label], Criteria, float]


def _run_monitor(
    requests: "Queue[MonitorRequest | None]",
    answers: Connection,
    config: MonitorConfig,
    records: bool,
) -> None:
    """Main function of the process: bytes in, results out; a tuple requests the summary."""
    # Otherwise a killed run would leave the monitor running.
    die_with_parent()
    gc.freeze()  # a collection over all loaded modules would copy the pages of a fork
    from analysis.monitor.monitor import Monitor

    monitor = Monitor(config)
    while (request := requests.get()) is not None:
        # Bytes are data, a tuple requests the summary, None ends the process.
        if isinstance(request, bytes) and records:
            answers.send(monitor.push_records(request))
        elif isinstance(request, bytes):
            answers.send(monitor.push_bytes([request], datagrams=False))
        else:
            answers.send(monitor.summary(*request))


class MonitorDiedError(RuntimeError):
    """The monitor's process ended early."""


@contextlib.contextmanager
def _block_signals(*signals: signal.Signals) -> Iterator[None]:
    """Block signals in processes started here: the parent handles them, and needs the summary."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows has no signals to mask
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class MonitorProcess:
    """A monitor that processes data in parallel to the caller.

    It takes frames, or with `records` complete records of a log, which it reads faster.
    """

    def __init__(self, config: MonitorConfig, *, records: bool = False) -> None:
        context = fork_context() or spawn_context()
        self._requests: Queue[MonitorRequest | None] = context.Queue(MAX_QUEUED_BATCHES)
        self._answers, child_end = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_run_monitor, args=(self._requests, child_end, config, records), daemon=True
        )
        with _block_signals(signal.SIGINT, signal.SIGTERM):
            self._process.start()
        # Only the child keeps it open, so that its death ends the pipe.
        child_end.close()
        self.pid = self._process.pid or 0
        self._batch, self._batch_size = bytearray(), FIRST_BYTES
        self.pending_batches = 0  # batches whose results have not come yet

    def __enter__(self) -> "MonitorProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # After an error, do not wait for results.
        if kind is not None:
            self._process.kill()
            # Otherwise the queue's thread would wait for a missing reader.
            self._requests.cancel_join_thread()
        else:
            self._requests.put(None)
        self._requests.close()
        self._process.join()
        self._answers.close()

    def feed(self, data: bytes, *, now: bool = False) -> list[Result]:
        """Send bytes to the process, in batches unless `now`; return the available results."""
        self._batch += data
        results: list[Result] = []
        # Poll once per batch: a poll costs more than collecting the bytes of a step.
        if len(self._batch) < self._batch_size and not now:
            return results
        self._batch_size = min(2 * self._batch_size, BATCH_BYTES)
        if self._batch:
            batch = bytes(self._batch)
            self._batch.clear()
            # Take results while the queue is full, or both bounded queues could deadlock.
            while not self._enqueued(batch):
                results += self._receive()
            self.pending_batches += 1
        while self.pending_batches and self._answers.poll():
            results += self._receive()
        return results

    def results(self) -> list[Result]:
        """Wait for the results of all data, and return them."""
        results = self.feed(b"", now=True)
        while self.pending_batches:
            results += self._receive()
        return results

    def summary(self, labels: Sequence[Label], criteria: Criteria, wall_s: float) -> dict[str, Any]:
        """Return the content of `summary.json`; call `results` first."""
        self._requests.put((list(labels), criteria, wall_s))
        summary: dict[str, Any] = self._answer()
        return summary

    def _enqueued(self, batch: bytes) -> bool:
        try:
            self._requests.put_nowait(batch)
        except queue.Full:
            return False
        return True

    def _receive(self) -> list[Result]:
        """Receive the results of the oldest pending batch."""
        results: list[Result] = self._answer()
        self.pending_batches -= 1
        return results

    def _answer(self) -> Any:
        """Receive from the process; MonitorDiedError if it has ended."""
        try:
            return self._answers.recv()
        except EOFError:
            # The exit code is known only after `join`.
            self._process.join()
            exit_text = describe_exit(self._process.exitcode or 0)
            raise MonitorDiedError(f"the monitor's process ended {exit_text}") from None
