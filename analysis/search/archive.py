"""The worst cases so far: the best few points, no two of them close together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MIN_DISTANCE = (
    0.1  # root-mean-square distance, per searched number, from which cases count as different
)
SPARE_FACTOR = 3  # candidates kept for each case asked for: some will turn out to have been lucky


class Case(NamedTuple):
    """One evaluation: its number, its point (d,) and what it came to."""

    number: int
    point: Array
    fitness: float


class Archive:
    """Keeps the candidates for the `keep` worst cases."""

    def __init__(self, keep: int) -> None:
        self._limit = keep * SPARE_FACTOR
        self.cases: list[Case] = []

    def add(self, first: int, points: Array, fitness: Array) -> None:
        """Take in evaluations `first`, `first` + 1, ... at points (n, d)."""
        # What is not better than the last kept case needs no search for neighbours.
        floor = self.cases[-1].fitness if len(self.cases) >= self._limit else -np.inf
        # Best first: a good point clears its neighbourhood before the worse ones ask for it.
        for i in np.argsort(-fitness, kind="stable"):
            if fitness[i] <= floor:
                break
            self._insert(Case(first + int(i), points[i], float(fitness[i])))

    def _insert(self, case: Case) -> None:
        """A case replaces its worse neighbours and gives way to a better one."""
        near = [
            other for other in self.cases if rms_distance(case.point, other.point) < MIN_DISTANCE
        ]
        if any(other.fitness >= case.fitness for other in near):
            return
        # The neighbours by identity: comparing cases would compare arrays.
        kept = [other for other in self.cases if not any(other is n for n in near)]
        # The number breaks ties, so that the order does not depend on how the batch was cut.
        self.cases = sorted([*kept, case], key=lambda c: (-c.fitness, c.number))[: self._limit]


def rms_distance(a: Array, b: Array) -> float:
    """Root-mean-square difference of two points (d,); 0 for points without numbers."""
    return float(np.sqrt(np.mean((a - b) ** 2))) if len(a) else 0.0
