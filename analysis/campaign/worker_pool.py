"""Who flies: processes of this machine, or a Ray cluster.

A flight that hangs is ended after its time limit, and one whose process dies is told; on a cluster
a flight whose node dies is flown again by another.
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

QUEUED_PER_WORKER = 2  # jobs that wait for each worker, so that none is idle
POLL_S = 1.0


class WorkerPool(Protocol):
    """Flies jobs, several at once; answers come in any order."""

    capacity: int

    def start(self, number: int, job: Job) -> None:
        """Begin a job under a number of the caller's."""

    def finished(self) -> tuple[int, JobAnswer]:
        """Wait for the next answer.

        Raises
        ------
        ConfigError
            If the campaign asks for what cannot be flown.
        """

    def close(self) -> None:
        """End all that is in the air."""


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
        # Called by a thread of the pool: a queue takes it over to ours.
        future.add_done_callback(lambda done: self._done.put((number, done)))

    def finished(self) -> tuple[int, JobAnswer]:
        """Wait for the next answer."""
        number, future = self._done.get()
        job = self._jobs.pop(number)
        try:
            return number, future.result()
        # A hung flight is a result like any other, or the campaign would never end.
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
    """Ctrl-C is the parent's, which ends its workers itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class RayWorkerPool:
    """A Ray cluster; flights whose node dies are flown again."""

    def __init__(self, address: str, limit_s: float) -> None:
        self._ray, self._mine = join_ray(address)
        self._limit_s = limit_s
        # At least one, whatever the cluster says of itself now.
        self.capacity = QUEUED_PER_WORKER * max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        # Retries of deaths without end; what a flight itself raises comes back as its answer.
        self._answer: Any = self._ray.remote(max_retries=-1)(_run_job_safely)
        self._flying: dict[Any, tuple[int, Job, float]] = {}

    def start(self, number: int, job: Job) -> None:
        """Begin a job."""
        self._flying[self._answer.remote(job)] = (number, job, time.monotonic())

    def finished(self) -> tuple[int, JobAnswer]:
        """Wait for the next answer."""
        while True:
            # With a time-out, to look for flights that hang.
            done, _ = self._ray.wait(list(self._flying), num_returns=1, timeout=POLL_S)
            if done:
                number, _, _ = self._flying.pop(done[0])
                found: JobAnswer = self._ray.get(done[0])
                return number, found
            for reference, (number, job, started_s) in self._flying.items():
                # Jobs wait for a free processor too, AHEAD of them for each.
                if time.monotonic() - started_s > QUEUED_PER_WORKER * self._limit_s:
                    self._ray.cancel(reference, force=True)
                    del self._flying[reference]
                    return number, aborted_answer(job, f"hung: not over after {self._limit_s:g} s")

    def close(self) -> None:
        """Leave the cluster."""
        for reference in self._flying:
            self._ray.cancel(reference, force=True)
        if self._mine:
            self._ray.shutdown()


def _run_job_safely(job: Job) -> JobAnswer:
    """The answer, also where the flight cannot be made."""
    try:
        return run_job(job)
    except ConfigError as error:
        return aborted_answer(job, str(error))


def open_worker_pool(workers: int, ray_address: str | None, limit_s: float) -> WorkerPool:
    """The fleet that the command line asks for."""
    if ray_address is not None:
        return RayWorkerPool(ray_address, limit_s)
    return LocalWorkerPool(workers, limit_s)
