"""An interactive search: one traced test at a time, saved on request."""

from pathlib import Path

import numpy as np

from analysis.search.cases import yaml_of_test
from analysis.search.evaluation.compiled_score import (
    EstimatedFlight,
    fly_estimated,
    score_estimated,
)
from analysis.search.evaluation.evaluator import Evaluator, average_draws, seed_of
from analysis.search.searchers import make_searcher
from analysis.search.shrink import pin_values
from analysis.search.space.test_file import TestFile
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat

COLUMNS = (
    "t_s", "north_m", "east_m", "down_m", "u_mps", "v_mps", "w_mps", "roll_rad", "pitch_rad",
    "yaw_rad", "p_rps", "q_rps", "r_rps", "gyro_x_rps", "gyro_y_rps", "gyro_z_rps",
    "accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "estimate_roll_rad", "estimate_pitch_rad",
    "estimate_yaw_rad",
)  # fmt: skip


class SearchSession:
    """The tests of a search, one at a time; the searcher gets each result.

    `error` and `worst` are in the criterion's unit, `values` those of the last test.
    """

    def __init__(self, test: TestFile, folder: Path) -> None:
        self.test = test
        self.folder = folder
        self.number = -1
        self.worst = 0.0
        self._evaluator = Evaluator(test)
        dimension = self._evaluator.space.dimension
        # Without a dimension only random search works: its points are the one test.
        self._searcher = make_searcher(
            test.method if dimension else "random", dimension, test.seed, 1
        )
        self._waiting: list[Array] = []
        self._evaluated: list[tuple[Array, float]] = []
        self.values: dict[str, float] = {}
        self.trace: EstimatedFlight | None = None
        self.error = 0.0

    def next(self) -> EstimatedFlight:
        """Fly the next test."""
        # A searcher works in batches: it gets the results when all points of one are flown.
        if not self._waiting:
            if self._evaluated:
                points, fitness = zip(*self._evaluated, strict=True)
                self._searcher.report(np.array(points), np.array(fitness))
            self._evaluated = []
            self._waiting = list(self._searcher.ask())
        point = self._waiting.pop(0)
        self.number += 1
        self.values = self._evaluator.space.values_at(point)
        self.trace = fly_estimated(self.test, self.values, seed_of(self.test.seed, self.number))
        scores = score_estimated(self.test, self.trace)
        self.error = float(average_draws([scores], 1, self.test.duration_s).fitness[0])
        self.worst = max(self.worst, self.error)
        self._evaluated.append((point, self.error))
        return self.trace

    @property
    def title(self) -> str:
        """The title of the flight."""
        unit = f" {self.test.unit}".rstrip()
        # Fitness is zero or less only where the flight left the envelope.
        if self.error <= 0.0:
            return f"test {self.number}: left the envelope"
        return (
            f"test {self.number}: error of {self.test.estimator} {self.error:.3f}{unit}"
            f" (worst so far {self.worst:.3f}{unit})"
        )

    def ranges(self) -> dict[str, tuple[float, float]]:
        """The range of each searched value; fixed values are left out."""
        space = self._evaluator.space
        ends = zip(space.low.tolist(), space.high.tolist(), strict=True)
        return dict(zip(space.names, ends, strict=True))

    def save(self) -> list[Path]:
        """Save the time series as CSV and the case as a test file."""
        assert self.trace is not None
        self.folder.mkdir(parents=True, exist_ok=True)
        table = self.folder / f"test-{self.number:04}.csv"
        np.savetxt(table, table_of(self.trace), "%.9g", ",", header=",".join(COLUMNS), comments="")
        case = self.folder / f"test-{self.number:04}.yaml"
        case.write_text(yaml_of_test(pin_values(self.test, self.values)))
        return [table, case]


def table_of(trace: EstimatedFlight) -> Array:
    """The time series (n, 22) with the columns of COLUMNS."""
    euler = euler_from_quat(trace.truth[:, 6:10])
    columns = (trace.t_s, trace.truth[:, :6], euler, trace.truth[:, 10:13], trace.imu)
    return np.column_stack([*columns, euler_from_quat(trace.q_nb)])
