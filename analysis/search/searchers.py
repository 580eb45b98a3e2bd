"""Search methods: ask and report in the unit cube, for the largest fitness.

A searcher depends only on its seed and the reported fitness, so that a search is resumed by
reporting the same fitness again. Noise in the fitness is expected.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from analysis.search.archive import rms_distance
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.numerics.arrays import Array

BATCH_POINTS = 256  # points per batch where the method has no population size


class Searcher(ABC):
    """The contract: `ask` and `report` take turns; chance comes from `_rng` alone."""

    STREAM: ClassVar[int]  # two methods on one seed draw different points

    def __init__(self, dimension: int, seed: int, budget: int) -> None:
        self._dimension = dimension
        self._rng = np.random.default_rng([seed, self.STREAM])

    @abstractmethod
    def ask(self) -> Array:
        """The next points (n, d) of the searched space to evaluate."""

    @abstractmethod
    def report(self, points: Array, fitness: Array) -> None:
        """Learn from their fitness (n,)."""


class RandomSearch(Searcher):
    """Independent uniform points."""

    STREAM = 1

    def ask(self) -> Array:
        """The next points."""
        return self._rng.random((BATCH_POINTS, self._dimension))

    def report(self, points: Array, fitness: Array) -> None:
        """Nothing is learned."""


class SobolSearch(RandomSearch):
    """A scrambled Sobol sequence, which fills the cube more evenly."""

    STREAM = 2

    def __init__(self, dimension: int, seed: int, budget: int) -> None:
        super().__init__(dimension, seed, budget)
        self._sequence = import_extra("scipy.stats.qmc").Sobol(dimension, rng=self._rng)

    def ask(self) -> Array:
        """The next points."""
        points: Array = self._sequence.random(BATCH_POINTS)
        return points


class MatyasSearch(Searcher):
    """Random optimisation (Matyas, Automation and Remote Control 26, 1965).

    A Gaussian step from the best point so far is kept if it is better; a tenth of the range wide.
    """

    STREAM = 3
    # Standard deviation: a tenth of the range.
    STEP = 0.1
    TOGETHER = 8

    def __init__(self, dimension: int, seed: int, budget: int) -> None:
        super().__init__(dimension, seed, budget)
        self._best = self._rng.random(dimension)
        self._fitness = -np.inf

    def ask(self) -> Array:
        """Steps from the best point; at first that point itself."""
        # The first point has no fitness yet to compare a step with.
        if self._fitness == -np.inf:
            return self._best[None, :]
        steps = self._rng.normal(0.0, self.STEP, (self.TOGETHER, len(self._best)))
        return np.clip(self._best + steps, 0.0, 1.0)

    def report(self, points: Array, fitness: Array) -> None:
        """Move to the best of points (n, d) if it is better."""
        k = int(np.argmax(fitness))
        if fitness[k] > self._fitness:
            self._best, self._fitness = points[k], float(fitness[k])


class CmaEsSearch(Searcher):
    """CMA-ES (the `cma` package) with restarts at random points, each with a larger population."""

    STREAM = 4
    SIGMA = 0.3
    GROWTH = 1.5

    def __init__(self, dimension: int, seed: int, budget: int) -> None:
        super().__init__(dimension, seed, budget)
        self._restarts = 0
        self._es = self._start(self._rng.random(dimension))

    def _start(self, x: Array) -> Any:
        # The usual population of CMA-ES, larger after each restart to explore more widely.
        size = round((4 + int(3 * np.log(self._dimension))) * self.GROWTH**self._restarts)
        return cma_strategy(x, self.SIGMA, size, self._rng)

    def ask(self) -> Array:
        """A generation."""
        # Stopped: converged or stagnant by its own criteria.
        if self._es.stop():
            self._restarts += 1
            self._es = self._start(self._rng.random(self._dimension))
        return np.array(self._es.ask())

    def report(self, points: Array, fitness: Array) -> None:
        """The generation's fitness."""
        # CMA-ES minimises.
        self._es.tell(list(points), list(-fitness))


def cma_strategy(x: Array, sigma: float, size: int, rng: np.random.Generator) -> Any:
    """A CMA evolution strategy from x (d,) in the unit cube that draws from `rng` alone."""
    import cma

    options = {
        "bounds": [0.0, 1.0],
        "popsize": size,
        "verbose": -9,
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan,  # does not seed the global generator
        "tolfun": 1e-4,
        "tolstagnation": 60,
    }
    return cma.CMAEvolutionStrategy(x, sigma, options)


class MixedSearch(Searcher):
    """The default: a Latin hypercube, then a race of CMA-ES runs from its best points.

    The runs start at well-separated points and share some generations; the best continue, one for
    each 10,000 evaluations of the budget. A stopped run is replaced by one with small steps from
    the best point of all.
    """

    STREAM = 6
    DESIGN = 64  # points, chosen
    RUNS, LAPS = 4, 8  # runs in the race, and its generations
    SIGMA, SMALL = 0.2, 0.1
    APART = 0.15  # RMS distance between the starting points

    def __init__(self, dimension: int, seed: int, budget: int) -> None:
        super().__init__(dimension, seed, budget)
        # The usual population of CMA-ES.
        self._size = 4 + int(3 * np.log(dimension))
        self._survivors = int(np.clip(budget // 10_000, 1, 16))
        self._lap = 0
        self._runs: list[Any] = []
        self._run_best: list[float] = []  # best fitness of each run
        # The centre of the cube until there is a result.
        self._best: tuple[float, Array] = (-np.inf, np.full(dimension, 0.5))
        self._starts: list[Array] = []

    def ask(self) -> Array:
        """The design, then a generation of every run."""
        if not self._starts:
            # A Latin hypercube: one point in each of `DESIGN` slices of every dimension.
            slices = np.tile(np.arange(self.DESIGN), (self._dimension, 1))
            slices = self._rng.permuted(slices, axis=1).T
            return (slices + self._rng.random(slices.shape)) / self.DESIGN
        # Once, after the last generation of the race.
        if self._lap == self.LAPS:
            order = np.argsort(self._run_best)[::-1][: self._survivors]
            self._runs = [self._runs[k] for k in order]
            self._run_best = [self._run_best[k] for k in order]
        self._lap += 1
        for k, run in enumerate(self._runs):
            if run.stop():
                # Small steps around the best point of all: the stopped run had already converged.
                self._runs[k] = cma_strategy(self._best[1], self.SMALL, self._size, self._rng)
        return np.concatenate([np.array(run.ask()) for run in self._runs])

    def report(self, points: Array, fitness: Array) -> None:
        """Report to every run its own generation of points (n, d)."""
        k = int(np.argmax(fitness))
        if fitness[k] > self._best[0]:
            self._best = float(fitness[k]), points[k]
        if not self._starts:
            self._begin(points[np.argsort(-fitness)])
            return
        count = len(self._runs)
        for k, (x, f) in enumerate(
            # `ask` concatenated the generations, all of one size.
            zip(np.split(points, count), np.split(fitness, count), strict=True)
        ):
            self._runs[k].tell(list(x), list(-f))
            self._run_best[k] = max(self._run_best[k], float(f.max()))

    def _begin(self, points: Array) -> None:
        """Start runs from the best of points (n, d) that are well separated."""
        for point in points:
            gaps = [rms_distance(point, start) for start in self._starts]
            if (
                # One start per run, or fewer where good points lie close together.
                len(self._starts) < max(self.RUNS, self._survivors)
                and min(gaps, default=1.0) > self.APART
            ):
                self._starts.append(point)
        self._runs = [cma_strategy(x, self.SIGMA, self._size, self._rng) for x in self._starts]
        self._run_best = [-np.inf] * len(self._runs)


METHODS: dict[str, type[Searcher]] = {
    "cmaes": CmaEsSearch,
    "matyas": MatyasSearch,
    "mixed": MixedSearch,
    "random": RandomSearch,
    "sobol": SobolSearch,
}


def make_searcher(method: str, dimension: int, seed: int, budget: int) -> Searcher:
    """Create the searcher of that name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    if method not in METHODS:
        raise ConfigError(f"method: {method!r} is unknown; known: {', '.join(METHODS)}")
    return METHODS[method](dimension, seed, budget)
