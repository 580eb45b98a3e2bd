"""Errors of positions against the truth: percentiles, and whether the sigmas told of them."""

import math
from array import array
from collections.abc import Sequence

import numpy as np

from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth_kernel import geodetic, ned_axes

HORIZONTAL, VERTICAL, LENGTH, OVER_SIGMA = range(4)
COLUMNS = 4
PERCENTILES = (50, 95)


class PositionScores:
    """By solution one row of numbers an epoch, as flat arrays: an hour at 5 Hz is half a MB."""

    def __init__(self) -> None:
        self._rows: dict[str, array[float]] = {}

    def add(
        self,
        solution: str,
        r_ecef_m: Sequence[float],
        sigma_m: Sequence[float] | None,
        true_ecef_m: Sequence[float],
    ) -> None:
        """A position and its sigmas (3,), in any axes, where the place is known."""
        off = np.subtract(r_ecef_m, true_ecef_m)
        lat, lon, _ = geodetic(np.asarray(true_ecef_m, dtype=float))
        north, east, down = (ned_axes(lat, lon) @ off).tolist()
        length = math.hypot(north, east, down)
        sigma = math.hypot(*sigma_m) if sigma_m is not None else math.nan
        row = math.hypot(north, east), abs(down), length, length / sigma if sigma else math.nan
        self._rows.setdefault(solution, array("d")).extend(row)

    def solutions(self) -> list[str]:
        """Whose errors are known."""
        return list(self._rows)

    def table(self, solution: str) -> Vector:
        """Errors (n, 4): horizontal, vertical, length in m, and the length over its sigma."""
        flat = np.frombuffer(self._rows.get(solution, array("d")), dtype=float)
        return flat.reshape(-1, COLUMNS)

    def rmse_m(self, solution: str) -> float | None:
        """Root mean square of the length; None without any."""
        length = self.table(solution)[:, LENGTH]
        return round(float(np.sqrt(np.mean(length**2))), 3) if len(length) else None

    def summary(self) -> dict[str, dict[str, float | int | None]]:
        """Percentiles by solution; those over sigma are 0.7 and 2 where sigmas are right."""
        return {name: _percentiles(self.table(name)) for name in self._rows}


def _percentiles(table: Vector) -> dict[str, float | int | None]:
    found: dict[str, float | int | None] = {"epochs": len(table)}
    for name, column in (("horizontal", HORIZONTAL), ("vertical", VERTICAL)):
        for percent in PERCENTILES:
            found[f"{name}_{percent}_m"] = round(float(np.percentile(table[:, column], percent)), 3)
        found[f"{name}_largest_m"] = round(float(table[:, column].max()), 3)
    known = table[np.isfinite(table[:, OVER_SIGMA]), OVER_SIGMA]
    for percent in PERCENTILES:
        share = round(float(np.percentile(known, percent)), 2) if len(known) else None
        found[f"over_sigma_{percent}"] = share
    return found
