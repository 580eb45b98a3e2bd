"""Worker pools: jobs in this process, in several processes of this machine, or on a Ray cluster.

A job is any object that can be pickled and has a method `run`. A hung job is ended after its time
limit, in which kernels that are compiled at first use do not count, and a process that dies fails
its job; on a cluster, a job whose node dies is repeated on another node.
"""

import itertools
import queue
import signal
import time
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import CancelledError, Future
from typing import Any, NamedTuple, Protocol

from pebble import ProcessExpired, ProcessPool

from analysis.processes import spawn_context
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.code_cache import IDLE_S, compiled_last_s

QUEUED_PER_WORKER = 2  # so that no worker is idle
POLL_S = 0.25


class Job(Protocol):
    """Work for any process; the answer can be pickled."""

    def run(self) -> Any:
        """Do the work.

        Raises
        ------
        ConfigError
            If the user's file makes it impossible.
        """


class JobFailure(NamedTuple):
    """The answer of a job that failed."""

    reason: str


class WorkerPool:
    """Runs as many jobs at once as it has `workers`; this one, in this process, one by one."""

    workers = 1

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, Job]] = deque()

    def start(self, number: int, job: Job) -> None:
        """Start a job under the caller's number."""
        self._waiting.append((number, job))

    def finished(self) -> tuple[int, Any]:
        """Wait for the next answer, or JobFailure, in any order; return its number and the
        answer."""
        number, job = self._waiting.popleft()
        return number, _run_job(job)

    def close(self) -> None:
        """End all unfinished jobs."""


class LocalWorkerPool(WorkerPool):
    """Processes of this machine, each with one job at a time; `limit_s` is that of a job."""

    def __init__(self, workers: int, limit_s: float | None = None) -> None:
        self.workers = workers
        self._limit_s = limit_s
        self._done: queue.SimpleQueue[tuple[int, Future[Any]]] = queue.SimpleQueue()
        self._begun_s: dict[Future[Any], float] = {}  # Unix time; 0 for a job that waits
        self._pool = ProcessPool(
            max_workers=workers, context=spawn_context(), initializer=_ignore_ctrl_c
        )

    def start(self, number: int, job: Job) -> None:
        """Begin a job."""
        future = self._pool.schedule(_run_job, args=[job])
        self._begun_s[future] = 0.0
        # Called in a thread of the pool: the queue passes it to this thread.
        future.add_done_callback(lambda done: self._done.put((number, done)))

    def finished(self) -> tuple[int, Any]:
        """Wait for the next answer."""
        while True:
            try:
                number, future = self._done.get(timeout=POLL_S)
                break
            except queue.Empty:
                self._end_hung()
        del self._begun_s[future]
        try:
            return number, future.result()
        except CancelledError:
            return number, _hung(self._limit_s)
        except ProcessExpired as dead:
            return number, JobFailure(f"its process died with code {dead.exitcode}")

    def _end_hung(self) -> None:
        """End jobs over their limit: each must give a result, or a campaign would never end."""
        now_s = time.time()
        for future in filter(Future.running, list(self._begun_s)):
            begun_s = self._begun_s[future] = self._begun_s[future] or now_s
            if self._limit_s is not None and now_s - begun_s > self._limit_s:
                compiled_s = compiled_last_s()
                # One function may take longer to compile than a flight may last.
                if compiled_s < begun_s or now_s - compiled_s > max(self._limit_s, IDLE_S):
                    future.cancel()

    def close(self) -> None:
        """End the processes."""
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()


class RayWorkerPool(WorkerPool):
    """A Ray cluster; jobs whose node dies are repeated.

    Raises
    ------
    ConfigError
        If Ray is not installed.
    """

    def __init__(self, address: str, limit_s: float | None = None) -> None:
        try:
            import ray
        except ImportError:
            raise ConfigError("--ray: Ray is not installed; run pip install ray") from None
        # A cluster that is already joined is left running.
        self._ray, self._owns_cluster = ray, not ray.is_initialized()
        if self._owns_cluster:
            ray.init(address=address, log_to_driver=False)
        self._limit_s = limit_s
        # At least one, even if the cluster has no free CPU yet.
        self.workers = max(1, int(ray.cluster_resources().get("CPU", 1)))
        # Unlimited retries after node failures; errors of the job itself return as its answer.
        self._answer: Any = ray.remote(max_retries=-1)(_run_job)
        self._running: dict[Any, tuple[int, float]] = {}

    def start(self, number: int, job: Job) -> None:
        """Begin a job."""
        self._running[self._answer.remote(job)] = (number, time.monotonic())

    def finished(self) -> tuple[int, Any]:
        """Wait for the next answer."""
        while True:
            # With a timeout, to check for hung jobs.
            done, _ = self._ray.wait(list(self._running), num_returns=1, timeout=POLL_S)
            if done:
                number, _ = self._running.pop(done[0])
                return number, self._ray.get(done[0])
            for reference, (number, started_s) in self._running.items():
                # The time includes waiting for a free processor.
                limit_s = QUEUED_PER_WORKER * (self._limit_s or float("inf"))
                if time.monotonic() - started_s > limit_s:
                    self._ray.cancel(reference, force=True)
                    del self._running[reference]
                    return number, _hung(self._limit_s)

    def close(self) -> None:
        """Disconnect from the Ray cluster."""
        for reference in self._running:
            self._ray.cancel(reference, force=True)
        if self._owns_cluster:
            self._ray.shutdown()


def open_worker_pool(
    workers: int | None, ray_address: str | None, limit_s: float | None = None
) -> WorkerPool:
    """Open the pool that the command line selects; a job with a limit needs its own process."""
    if ray_address is not None:
        return RayWorkerPool(ray_address, limit_s)
    if limit_s is None and workers in (None, 1):
        return WorkerPool()
    return LocalWorkerPool(workers or 1, limit_s)


def run_sequences(pool: WorkerPool, sequences: Iterable[Generator[Job, Any, None]]) -> None:
    """Run sequences of jobs at once; each is sent the answer of its job and yields the next."""
    waiting = iter(sequences)
    running: dict[int, Generator[Job, Any, None]] = {}
    numbers = itertools.count()

    def proceed(sequence: Generator[Job, Any, None], answer: Any) -> None:
        try:
            job = sequence.send(answer)
        except StopIteration:
            return
        number = next(numbers)
        running[number] = sequence
        pool.start(number, job)

    while True:
        while len(running) < QUEUED_PER_WORKER * pool.workers:
            sequence = next(waiting, None)
            if sequence is None:
                break
            # A generator starts by being sent None.
            proceed(sequence, None)
        if not running:
            return
        number, answer = pool.finished()
        proceed(running.pop(number), answer)


def run_jobs(pool: WorkerPool, jobs: Sequence[Job]) -> list[Any]:
    """Run jobs at once; return their answers in order.

    Raises
    ------
    ConfigError
        If a job failed.
    """
    answers: list[Any] = [None] * len(jobs)

    def keep_answer(i: int, job: Job) -> Generator[Job, Any, None]:
        answers[i] = yield job

    run_sequences(pool, (keep_answer(i, job) for i, job in enumerate(jobs)))
    for answer in answers:
        if isinstance(answer, JobFailure):
            raise ConfigError(answer.reason)
    return answers


def _run_job(job: Job) -> Any:
    """Run a job; an error of the user's file is its answer."""
    try:
        return job.run()
    except ConfigError as error:
        return JobFailure(str(error))


def _hung(limit_s: float | None) -> JobFailure:
    return JobFailure(f"hung: not over after {limit_s:g} s")


def _ignore_ctrl_c() -> None:
    """Ignore Ctrl-C in a worker: the parent handles it and ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
