"""Protection levels against the truth: the counts of a Stanford diagram."""

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from analysis.recordings.position_reference import PositionReference
from analysis.results import Decision, Result
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

ALERT_LIMITS_M = {"horizontal": 40.0, "vertical": 50.0}  # ICAO annex 10, approach APV-I
ERROR, LEVEL = 0, 1  # columns of a row


class Integrity:
    """Errors and protection levels (n, 2) of the epochs that have both, by direction."""

    def __init__(self, reference: PositionReference | None) -> None:
        self._reference = reference
        self.pairs: dict[str, list[tuple[float, float]]] = {name: [] for name in ALERT_LIMITS_M}
        self.assumed: Counter[str] = Counter()
        self._epochs = 0

    def add(self, results: Iterable[Result]) -> None:
        """Add the decisions among some results."""
        for result in results:
            if not isinstance(result, Decision):
                continue
            self._epochs += 1
            self.assumed.update(filter(None, [result.level_assumes]))
            true_m = self._reference.at(result.t_us) if self._reference is not None else None
            if result.position_ecef_m is None or true_m is None:
                continue
            lat, lon, _ = geodetic_position(np.array(true_m))
            north, east, down = ned_axes(lat, lon) @ np.subtract(result.position_ecef_m, true_m)
            errors = float(np.hypot(north, east)), float(abs(down))
            for name, error, level in zip(
                ALERT_LIMITS_M, errors, (result.hpl_m, result.vpl_m), strict=True
            ):
                if level is not None:
                    self.pairs[name].append((error, level))

    def summary(self) -> dict[str, dict[str, Any]]:
        """By direction: epochs, those with a level, the median level, epochs with an error above it
        (misleading), the largest error over its level, the share within the alert limit, and the
        assumptions of the levels with their number of epochs."""
        summary: dict[str, dict[str, Any]] = {}
        for name, limit_m in ALERT_LIMITS_M.items():
            table = self.table(name)
            if not len(table):
                continue
            summary[name] = {
                "epochs": self._epochs,
                "with_level": len(table),
                "median_level_m": round(float(np.median(table[:, LEVEL])), 2),
                "misleading": int((table[:, ERROR] > table[:, LEVEL]).sum()),
                "largest_error_over_level": round(float((table[:, 0] / table[:, 1]).max()), 3),
                "alert_limit_m": limit_m,
                "available_share": round(float((table[:, LEVEL] <= limit_m).mean()), 4),
                "assumes": dict(self.assumed.most_common()),
            }
        return summary

    def table(self, name: str) -> Vector:
        """Errors and levels (n, 2) in one direction."""
        return np.array(self.pairs[name], dtype=float).reshape(-1, 2)
