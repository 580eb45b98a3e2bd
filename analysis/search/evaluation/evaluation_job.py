"""Evaluations as jobs of a worker pool: the number of an evaluation determines its noise, so that
all pools give the same outcome."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.flying.worker_pool import WorkerPool, run_jobs
from analysis.search.evaluation.evaluator import EvaluationOutcome, Evaluator
from analysis.search.space.test_file import TestFile


class EvaluationJob(NamedTuple):
    """Points (n, d), evaluated as `Evaluator.evaluate` does."""

    evaluator: Evaluator
    points: NDArray[np.float64]
    seed: int
    first: int
    draws: int

    def run(self) -> EvaluationOutcome:
        """Evaluate the points in this process."""
        return self.evaluator.evaluate(self.points, self.seed, self.first, self.draws)


def evaluate_with(
    pool: WorkerPool,
    test: TestFile,
    points: NDArray[np.float64],
    seed: int,
    first: int,
    draws: int,
) -> EvaluationOutcome:
    """Evaluate points (n, d) with a worker pool, split into a job for each worker."""
    evaluator = Evaluator(test)
    _ = evaluator.space  # goes with the jobs, since reading the airframe takes time
    cuts = np.linspace(0, len(points), min(pool.workers, len(points)) + 1).astype(int).tolist()
    jobs = [
        EvaluationJob(evaluator, points[a:b], seed, first + a, draws) for a, b in pairwise(cuts)
    ]
    outcomes = run_jobs(pool, jobs)
    arrays = {
        name: np.concatenate([getattr(outcome, name) for outcome in outcomes])
        for name in EvaluationOutcome._fields
        if name != "steps"
    }
    return EvaluationOutcome(**arrays, steps=sum(outcome.steps for outcome in outcomes))
