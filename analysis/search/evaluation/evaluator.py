"""The evaluator of a test: the compiled kernels, or the simulator."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.search.evaluation.compiled_batch import Batch, EvaluationOutcome
from analysis.search.space.dimensions import Space
from analysis.search.space.test_file import TestFile

Array = NDArray[np.float64]


class Evaluator(Protocol):
    """The same points, seed and numbers give the same outcome (an autopilot's may vary)."""

    @property
    def space(self) -> Space:
        """The search space."""

    def evaluate(
        self, points: Array, seed: int, first: int, draws: int | None = None
    ) -> EvaluationOutcome:
        """Fly points (n, d) of the unit cube; `first` is the number of the first evaluation."""

    def evaluate_values(
        self,
        values: Mapping[str, Array],
        seed: int,
        first: int,
        draws: int,
        same_noise: bool = False,
    ) -> EvaluationOutcome:
        """Fly values (n,) by name; with the same noise for all if `same_noise`."""


def make_evaluator(test: TestFile) -> Evaluator:
    """Create the evaluator of a test."""
    # The simulator's parts are loaded for tests that need them.
    if test.simulated:
        from analysis.search.evaluation.simulated_batch import SimulatedBatch

        return SimulatedBatch(test)
    return Batch(test)
