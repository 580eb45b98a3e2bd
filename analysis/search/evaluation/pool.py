"""Worker pools for evaluations: this process, several processes, or a Ray cluster.

The number of an evaluation determines its noise, so that all pools give the same outcome.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from itertools import pairwise
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.processes import spawn_context
from analysis.search.evaluation.compiled_batch import EvaluationOutcome
from analysis.search.evaluation.evaluator import Evaluator, make_evaluator
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.errors import ConfigError

Array = NDArray[np.float64]
Job = tuple[bytes, Array, int, int, int]  # test, points, seed, first number, draws


class Pool(Protocol):
    """Evaluates points of a test."""

    def evaluate(
        self, test: TestFile, points: Array, seed: int, first: int, draws: int
    ) -> EvaluationOutcome:
        """See `Batch.evaluate`."""

    def close(self) -> None:
        """Release the processes."""


@lru_cache(maxsize=8)
def cached_evaluator(encoded: bytes) -> Evaluator:
    """The evaluator of a test in JSON; cached, since reading the airframe takes time."""
    return make_evaluator(msgspec.json.decode(encoded, type=TestFile))


def evaluate_job(job: Job) -> EvaluationOutcome:
    """Evaluate one part of a batch, in any process."""
    encoded, points, seed, first, draws = job
    return cached_evaluator(encoded).evaluate(points, seed, first, draws)


def split_jobs(
    test: TestFile, points: Array, seed: int, first: int, draws: int, count: int
) -> list[Job]:
    """Split points (n, d) into at most `count` jobs."""
    encoded = msgspec.json.encode(test)
    cuts = np.linspace(0, len(points), min(count, len(points)) + 1).astype(int).tolist()
    return [(encoded, points[a:b], seed, first + a, draws) for a, b in pairwise(cuts)]


def join_outcomes(outcomes: Sequence[EvaluationOutcome]) -> EvaluationOutcome:
    """Concatenate outcomes."""
    arrays = {
        name: np.concatenate([getattr(outcome, name) for outcome in outcomes])
        for name in EvaluationOutcome._fields
        if name != "steps"
    }
    return EvaluationOutcome(**arrays, steps=sum(outcome.steps for outcome in outcomes))


class InProcessPool:
    """Evaluates in this process."""

    def evaluate(
        self, test: TestFile, points: Array, seed: int, first: int, draws: int
    ) -> EvaluationOutcome:
        """See `Batch.evaluate`."""
        return evaluate_job((msgspec.json.encode(test), points, seed, first, draws))

    def close(self) -> None:
        """Nothing to release."""


class LocalProcessPool:
    """Evaluates in several processes of this machine."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool = ProcessPoolExecutor(workers, mp_context=spawn_context())

    def evaluate(
        self, test: TestFile, points: Array, seed: int, first: int, draws: int
    ) -> EvaluationOutcome:
        """See `Batch.evaluate`."""
        jobs = split_jobs(test, points, seed, first, draws, self._workers)
        return join_outcomes(list(self._pool.map(evaluate_job, jobs)))

    def close(self) -> None:
        """End the processes."""
        self._pool.shutdown(cancel_futures=True)


def join_ray(address: str) -> tuple[Any, bool]:
    """Ray, connected to a cluster, and whether this call connected it.

    Raises
    ------
    ConfigError
        If Ray is not installed.
    """
    try:
        import ray
    except ImportError:
        raise ConfigError("--ray: Ray is not installed; run pip install ray") from None
    connected = not ray.is_initialized()
    if connected:
        ray.init(address=address, log_to_driver=False)
    return ray, connected


class RayPool:
    """Evaluates on a Ray cluster; if a worker dies, another repeats its job."""

    def __init__(self, address: str) -> None:
        self._ray, self._mine = join_ray(address)
        self._work: Callable[..., Any] = self._ray.remote(max_retries=-1)(evaluate_job).remote

    def evaluate(
        self, test: TestFile, points: Array, seed: int, first: int, draws: int
    ) -> EvaluationOutcome:
        """See `Batch.evaluate`."""
        count = 2 * max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        jobs = split_jobs(test, points, seed, first, draws, count)
        return join_outcomes(self._ray.get([self._work(job) for job in jobs]))

    def close(self) -> None:
        """Leave the cluster."""
        if self._mine:
            self._ray.shutdown()


def pool_of(workers: int | None, ray_address: str | None) -> Pool:
    """The pool that the command line requests."""
    if ray_address is not None:
        return RayPool(ray_address)
    return LocalProcessPool(workers) if workers is not None and workers > 1 else InProcessPool()
