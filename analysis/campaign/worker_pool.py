"""Worker pools that fly jobs: processes of this machine, or a Ray cluster.

A hung flight is ended after its time limit, and a dead process gives an aborted result; on a
cluster, a flight whose node dies is repeated on another node.
"""

import queue
import signal
import time
from concurrent.futures import Future
from typing import Any, Protocol

from pebble import ProcessExpired, ProcessPool

from analysis.campaign.flying.flight_job import Job, JobAnswer, aborted_answer, run_job
from analysis.processes import spawn_context
from analysis.search.evaluation.pool import join_ray
from mavproxy_fault.documents.errors import ConfigError

QUEUED_PER_WORKER = 2  # so that no worker is idle
POLL_S = 1.0


class WorkerPool(Protocol):
    """Flies several jobs at once; answers come in any order."""

    capacity: int

    def start(self, number: int, job: Job) -> None:
        """Start a job under the caller's number."""

    def finished(self) -> tuple[int, JobAnswer]:
        """Wait for the next answer; return its number and the answer."""

    def close(self) -> None:
        """End all unfinished flights."""


class LocalWorkerPool:
    """Processes of this machine, each with one flight at a time."""

    def __init__(self, workers: int, limit_s: float) -> None:
        self.capacity = QUEUED_PER_WORKER * workers
        self._limit_s = limit_s
        self._jobs: dict[int, Job] = {}
        self._done: queue.SimpleQueue[tuple[int, Future[JobAnswer]]] = queue.SimpleQueue()
        self._pool = ProcessPool(
            max_workers=workers, context=spawn_context(), initializer=_ignore_ctrl_c
        )

    def start(self, number: int, job: Job) -> None:
        """Begin a job."""
        self._jobs[number] = job
        future = self._pool.schedule(run_job, args=[job], timeout=self._limit_s)
        # Called in a thread of the pool: the queue passes it to this thread.
        future.add_done_callback(lambda done: self._done.put((number, done)))

    def finished(self) -> tuple[int, JobAnswer]:
        """Wait for the next answer."""
        number, future = self._done.get()
        job = self._jobs.pop(number)
        try:
            return number, future.result()
        # A hung flight must give a result, or the campaign would never end.
        except TimeoutError:
            return number, aborted_answer(job, f"hung: not over after {self._limit_s:g} s")
        except ProcessExpired as dead:
            return number, aborted_answer(job, f"its process died with code {dead.exitcode}")
        except ConfigError as error:
            return number, aborted_answer(job, str(error))

    def close(self) -> None:
        """End the processes."""
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()


def _ignore_ctrl_c() -> None:
    """Ignore Ctrl-C in a worker: the parent handles it and ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class RayWorkerPool:
    """A Ray cluster; flights whose node dies are repeated."""

    def __init__(self, address: str, limit_s: float) -> None:
        self._ray, self._owns_cluster = join_ray(address)
        self._limit_s = limit_s
        # At least one, even if the cluster has no free CPU yet.
        self.capacity = QUEUED_PER_WORKER * max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        # Unlimited retries after node failures; errors of the flight itself return as its answer.
        self._answer: Any = self._ray.remote(max_retries=-1)(_run_job_safely)
        self._running: dict[Any, tuple[int, Job, float]] = {}

    def start(self, number: int, job: Job) -> None:
        """Begin a job."""
        self._running[self._answer.remote(job)] = (number, job, time.monotonic())

    def finished(self) -> tuple[int, JobAnswer]:
        """Wait for the next answer."""
        while True:
            # With a timeout, to check for hung flights.
            done, _ = self._ray.wait(list(self._running), num_returns=1, timeout=POLL_S)
            if done:
                number, _, _ = self._running.pop(done[0])
                answer: JobAnswer = self._ray.get(done[0])
                return number, answer
            for reference, (number, job, started_s) in self._running.items():
                # The time includes waiting for a free processor.
                if time.monotonic() - started_s > QUEUED_PER_WORKER * self._limit_s:
                    self._ray.cancel(reference, force=True)
                    del self._running[reference]
                    return number, aborted_answer(job, f"hung: not over after {self._limit_s:g} s")

    def close(self) -> None:
        """Leave the cluster."""
        for reference in self._running:
            self._ray.cancel(reference, force=True)
        if self._owns_cluster:
            self._ray.shutdown()


def _run_job_safely(job: Job) -> JobAnswer:
    """Fly a job, and turn errors into an aborted answer."""
    try:
        return run_job(job)
    except ConfigError as error:
        return aborted_answer(job, str(error))


def open_worker_pool(workers: int, ray_address: str | None, limit_s: float) -> WorkerPool:
    """Open the worker pool that the command line selects."""
    if ray_address is not None:
        return RayWorkerPool(ray_address, limit_s)
    return LocalWorkerPool(workers, limit_s)
