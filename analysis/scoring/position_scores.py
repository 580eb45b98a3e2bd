"""Position errors against the truth: percentiles, also relative to the reported sigmas."""

from array import array

import numpy as np
from numpy.typing import ArrayLike

from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth import geodetic_from_ecef, rot_en

HORIZONTAL, VERTICAL, LENGTH, OVER_SIGMA = range(4)
COLUMNS = 4  # these
PERCENTILES = (50, 95)  # as receivers' data sheets and the GPS standard state accuracies
UNKNOWN = (np.nan, np.nan, np.nan)  # a position, or its sigma


class PositionScores:
    """One row per solution and epoch, in flat arrays: an hour at 5 Hz is half a MB."""

    def __init__(self) -> None:
        self._rows: dict[str, array[float]] = {}

    def add(
        self,
        solution: str,
        r_ecef_m: ArrayLike,
        sigma_m: ArrayLike | None,
        true_ecef_m: ArrayLike,
    ) -> None:
        """Add positions (n, 3) or (3,), their sigmas in any axes, and the true positions."""
        true_m = np.atleast_2d(np.asarray(true_ecef_m, dtype=float))
        off = np.asarray(r_ecef_m, dtype=float) - true_m
        lat, lon, _ = geodetic_from_ecef(true_m)
        north, east, down = np.einsum("nij,ni->jn", rot_en(lat, lon), off)
        length = np.linalg.norm(off, axis=1)
        sigma = np.linalg.norm(UNKNOWN if sigma_m is None else sigma_m, axis=-1)
        over_sigma = length / np.where(sigma > 0.0, sigma, np.nan)
        table = np.column_stack([np.hypot(north, east), np.abs(down), length, over_sigma])
        self._rows.setdefault(solution, array("d")).frombytes(table.tobytes())

    def solutions(self) -> list[str]:
        """Names of the solutions with errors."""
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
        """Percentiles by solution; relative to sigma 0.7 and 2 where sigmas are right."""
        return {name: _percentiles(self.table(name)) for name in self._rows}


def _percentiles(table: Vector) -> dict[str, float | int | None]:
    result: dict[str, float | int | None] = {"epochs": len(table)}
    for name, column in (("horizontal", HORIZONTAL), ("vertical", VERTICAL)):
        for percent in PERCENTILES:
            result[f"{name}_{percent}_m"] = round(
                float(np.percentile(table[:, column], percent)), 3
            )
        result[f"{name}_largest_m"] = round(float(table[:, column].max()), 3)
    known = table[np.isfinite(table[:, OVER_SIGMA]), OVER_SIGMA]
    for percent in PERCENTILES:
        share = round(float(np.percentile(known, percent)), 2) if len(known) else None
        result[f"over_sigma_{percent}"] = share
    return result
