"""The worst cases so far: the points of highest fitness, no two of them close together."""

from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.arrays import Array

MIN_DISTANCE = 0.1  # RMS distance of different cases in the unit cube: a tenth of the range
SPARE_FACTOR = 3  # candidates per requested case: the fitness of some is due to their noise draw


class Case(NamedTuple):
    """One evaluation: its number, its point (d,) and its fitness."""

    number: int
    point: Array
    fitness: float


class Archive:
    """Keeps the candidates for the `keep` worst cases."""

    def __init__(self, keep: int) -> None:
        self._limit = keep * SPARE_FACTOR
        self.cases: list[Case] = []

    def add(self, first: int, points: Array, fitness: Array) -> None:
        """Add evaluations `first`, `first` + 1, ... at points (n, d)."""
        # A point not better than the last kept case needs no search for neighbours.
        floor = self.cases[-1].fitness if len(self.cases) >= self._limit else -np.inf
        # Best first: a good point claims its neighbourhood before worse ones.
        for i in np.argsort(-fitness, kind="stable"):
            if fitness[i] <= floor:
                break
            self._insert(Case(first + int(i), points[i], float(fitness[i])))

    def _insert(self, case: Case) -> None:
        """A case replaces worse neighbours; a better neighbour keeps it out."""
        near = [
            other for other in self.cases if rms_distance(case.point, other.point) < MIN_DISTANCE
        ]
        if any(other.fitness >= case.fitness for other in near):
            return
        # Neighbours are compared by identity: comparing cases would compare arrays.
        kept = [other for other in self.cases if not any(other is n for n in near)]
        # The number breaks ties, so that the order does not depend on how batches were split.
        self.cases = sorted([*kept, case], key=lambda c: (-c.fitness, c.number))[: self._limit]


def rms_distance(a: Array, b: Array) -> float:
    """Root-mean-square difference of two points (d,); 0 if d is 0."""
    return float(np.sqrt(np.mean((a - b) ** 2))) if len(a) else 0.0
