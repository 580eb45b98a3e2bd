"""GTSAM's fixed-lag smoother with names for its factors, so that they can be removed.

Time stamps are rounded down to intervals as long as the lag, and an interval is marginalised at
once when the next but one begins (docs/fusion.md says why). Cholesky takes half the time of QR but
needs variables of similar scale; QR takes `any_scale`.
"""

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import gtsam
import numpy as np

from analysis.detection.values import Value
from analysis.samples.sample import Vector

SPANS_PER_INTERVAL = 2  # per interval, for slow states
LAG_INTERVALS = 1.5  # intervals: the newest and the one before, robust to rounding
SPAN_OFFSET = 1 << 20  # keeps span numbers positive
ROUNDING = 1e-9
NEVER = 1e9
WILDFIRE_THRESHOLD = 0.02  # m, rad, m/s: older variables that moved less keep their estimate
# How far a variable moves before it is relinearised, in its units (rad, m, m/s; m/s^2, rad/s):
# ranges, clocks and accelerometer biases are almost linear, rotations are not. Older variables are
# checked only where newer ones moved as far. Measured: docs/fusion.md.
RELINEARISE = {
    "x": [0.02] * 3 + [3.0] * 3,
    "v": [2.0] * 3,
    "b": [1.0] * 3 + [0.01] * 3,
    "c": [NEVER] * 2,
    "r": [NEVER],
    "h": [NEVER],
    "w": [2.0] * 3,
}


class FactorSlots(Value, frozen=True):
    """The slots of some factors and the stamp of the oldest variable they involve."""

    stamp_s: float
    slots: tuple[int, ...]


@lru_cache(maxsize=16 * 1024)
def variable_key(letter: str, epoch: int) -> int:
    """GTSAM's key of a variable."""
    return int(gtsam.symbol(letter, epoch))


class FactorWindow:
    """Variables and factors of the last `lag_s` seconds; changed in place, as GTSAM's smoother is.

    Factors are named by source and epoch. Insertions and removals take effect at the next `commit`.
    """

    def __init__(self, lag_s: float, any_scale: bool = False) -> None:
        params = gtsam.ISAM2Params()
        params.setFactorization("QR" if any_scale else "CHOLESKY")
        params.findUnusedFactorSlots = True
        params.relinearizeSkip = 1
        params.enablePartialRelinearizationCheck = True
        steps = gtsam.ISAM2GaussNewtonParams()
        steps.setWildfireThreshold(WILDFIRE_THRESHOLD)
        params.setOptimizationParams(steps)
        thresholds = gtsam.ISAM2ThresholdMap()
        for letter, values in RELINEARISE.items():
            thresholds.insert((letter, np.array(values)))
        params.setRelinearizeThreshold(thresholds)
        self._interval_s = lag_s
        self.smoother = gtsam.IncrementalFixedLagSmoother(LAG_INTERVALS * lag_s, params)
        self._entries: dict[tuple[str, int], FactorSlots] = {}
        self._newest_s = self._forgotten_s = -NEVER
        self._clear()

    def _clear(self) -> None:
        self._batch = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._stamps: dict[Any, Any] = {}
        self._staged: list[tuple[tuple[str, int], float, int]] = []
        self._removed: list[int] = []

    def stamp(self, t_s: float) -> float:
        """The start of the interval that contains a time."""
        return math.floor(t_s / self._interval_s + ROUNDING) * self._interval_s

    @property
    def span_s(self) -> float:
        """How long a span is."""
        return self._interval_s / SPANS_PER_INTERVAL

    def span(self, t_s: float) -> int:
        """The number, above zero, of the span that contains a time."""
        return math.floor(t_s / self.span_s + ROUNDING) + SPAN_OFFSET

    def span_stamp(self, span: int) -> float:
        """The start of the interval that contains a span."""
        return self.stamp((span - SPAN_OFFSET) * self.span_s)

    @property
    def oldest_s(self) -> float:
        """Variables with an older stamp are marginalised by the next commit."""
        return self._newest_s - LAG_INTERVALS * self._interval_s

    def insert(self, values: Any, names: Iterable[int], stamp_s: float) -> None:
        """Insert variables with their initial values and the `stamp` of their time."""
        self._values.insert(values)
        self._newest_s = max(self._newest_s, stamp_s)
        self._stamps.update(dict.fromkeys(names, stamp_s))

    def attach(self, source: str, epoch: int, stamp_s: float, *factors: Any) -> None:
        """Attach factors of a source at an epoch, with the stamp of the oldest variable they
        involve."""
        for factor in factors:
            self._batch.add(factor)
        self._staged.append(((source, epoch), stamp_s, len(factors)))

    def remove(self, source: str, epoch: int) -> bool:
        """Remove the factors of a source at an epoch; returns whether there were any."""
        entry = self._entries.pop((source, epoch), None)
        if entry is None:
            return False
        self._removed += entry.slots
        return True

    def contains(self, source: str, epoch: int) -> bool:
        """Whether there are factors of a source at an epoch, committed or not."""
        name = (source, epoch)
        return name in self._entries or any(staged == name for staged, _, _ in self._staged)

    def committed(self) -> list[tuple[str, int]]:
        """Source and epoch of all committed factors."""
        return list(self._entries)

    def slots(self, source: str, epoch: int) -> tuple[int, ...]:
        """GTSAM's slots of the factors of a source at an epoch."""
        entry = self._entries.get((source, epoch))
        return entry.slots if entry is not None else ()

    def commit(self) -> None:
        """Solve with all changes since the last commit.

        Raises
        ------
        RuntimeError
            From GTSAM, if the system cannot be solved.
        """
        # GTSAM reuses the slots of marginalised factors: drop them first.
        if self.oldest_s > self._forgotten_s:
            self._forgotten_s = self.oldest_s
            self._entries = {
                name: entry
                for name, entry in self._entries.items()
                if entry.stamp_s >= self.oldest_s
            }
        smoother = self.smoother
        smoother.update(self._batch, self._values, self._stamps, self._removed)
        slots = list(smoother.getISAM2Result().getNewFactorsIndices())
        start = 0
        for name, stamp_s, count in self._staged:
            known = self._entries.get(name)
            before = known.slots if known is not None else ()
            if stamp_s >= self.oldest_s:  # others were marginalised in the same update
                self._entries[name] = FactorSlots(
                    stamp_s, before + tuple(slots[start : start + count])
                )
            start += count
        removed = bool(self._removed)
        self._clear()
        if removed:
            smoother.update()  # the first update only removes them

    def covariance(self, names: list[int]) -> Vector:
        """Joint marginal covariance of some variables."""
        return np.asarray(self.smoother.getISAM2().jointMarginalCovariance(names).fullMatrix())
