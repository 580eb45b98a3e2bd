"""The contract of both evaluators of a test: the compiled kernels, and the simulator."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.search.space.dimensions import Space
from analysis.search.space.test_file import TestFile

Array = NDArray[np.float64]


class EvaluationOutcome(NamedTuple):
    """The results of n evaluations.

    `fitness` (n,) is the criterion in its unit (`TestFile.unit`), or, where the flight left the
    envelope, minus the share of the time that remained (-1 to 0); `spread_deg` (n,) is its standard
    deviation over the noise draws. `rmse_deg` and `largest_deg` (n, 4): roll, pitch, yaw, angle (in
    the kernels 0 unless the criterion is the angle), means over the noise draws. `broken_limit`
    (n,): indices into `rows.LIMITS`; `steps` flown and scored in total. `inverted_rmse` (n, 3):
    height [m], airspeed [m/s] and position [m] of the inverted sensor models, where the criterion
    is one of them.
    """

    fitness: Array
    spread_deg: Array
    rmse_deg: Array
    largest_deg: Array
    broken_limit: NDArray[np.int64]
    steps: int
    inverted_rmse: Array


def average_draws(
    worst: Array, rmse_deg: Array, largest_deg: Array, limit: Array, lasted: Array, steps: int,
    inverted: Array | None = None,
) -> EvaluationOutcome:  # fmt: skip
    """The outcome of n evaluations of some draws: criterion, limit and share of the time flown
    (n, draws), errors (n, draws, 4), and (n, draws, 3) those of inverted models."""
    # One limit for all draws: one violation is enough.
    broken = limit.max(axis=1).astype(np.int64)
    # From -1 to 0: longer flights score better, which leads a search back into the envelope.
    fitness = np.where(broken > 0, np.minimum(lasted.min(axis=1), 1.0) - 1.0, worst.mean(axis=1))
    return EvaluationOutcome(
        # An estimator that diverges to NaN cannot be ranked.
        np.nan_to_num(fitness, nan=-1.0),
        worst.std(axis=1),
        rmse_deg.mean(axis=1),
        largest_deg.mean(axis=1),
        broken,
        steps,
        np.zeros((len(worst), 3)) if inverted is None else inverted.mean(axis=1),
    )


@dataclass(frozen=True)
class Evaluator(ABC):
    """The same points, seed and numbers give the same outcome (an autopilot's may vary)."""

    test: TestFile

    @property
    @abstractmethod
    def space(self) -> Space:
        """The search space."""

    @abstractmethod
    def evaluate_values(
        self,
        values: Mapping[str, Array],
        seed: int,
        first: int,
        draws: int,
        same_noise: bool = False,
    ) -> EvaluationOutcome:
        """Fly values (n,) by name, `draws` times each; with the same noise for all if
        `same_noise`. `first` is the number of the first evaluation."""

    def evaluate(
        self, points: Array, seed: int, first: int, draws: int | None = None
    ) -> EvaluationOutcome:
        """Fly points (n, d) of the unit cube, each with its own noise, by seed and number."""
        draws = self.test.noise_draws if draws is None else draws
        return self.evaluate_values(self.space.values(points), seed, first, draws)
