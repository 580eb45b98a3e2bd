"""Entire systems (constellations) as hypotheses beside satellites, IMU and clock.

A system competes by rule D like the other hypotheses (docs/fdi.md, "Entire systems"), so healthy
satellites of another one are not left out one by one. Where it is ambiguous which of two systems
moved, neither is used.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.measurement import systems_in_use
from analysis.detection.receiver.carry_off_windows import LEAST_RATIO_LEAD
from analysis.detection.statistics.bank import freed_statistic
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector

PENALTY = 2.0  # per freed parameter, as in Akaike's criterion
SYSTEM_PENALTY = 6.0  # a system fails as a whole less often than one of its satellites
LEAST_MOVED, LEAST_CLOCK = 5, 3  # satellites of a system: one more than its parameters, two
SYSTEM_CLOCK = "system-clock"
SYSTEMS_CONTRADICT = "two systems contradict each other, and it is ambiguous which one is wrong"
ONE_FOLLOWED = f"{SYSTEMS_CONTRADICT}: one is followed, the bounds cover both"
FREED_PARAMETERS = ((1, LEAST_CLOCK, SYSTEM_CLOCK), (4, LEAST_MOVED, "satellites"))
SHIFT_GAIN = chi_square_threshold(3, 0.01)  # that three more parameters gain by chance in 1 %


class SystemGroups(NamedTuple):
    """The satellites of each system, by their places, and what a shift of position (3) and clock of
    the system does to the innovations (systems, n, 4)."""

    rows: tuple[tuple[int, ...], ...]
    columns: Vector


NO_SYSTEM_GROUPS = SystemGroups((), np.empty((0, 0, 4)))


class Explanation(Value, frozen=True):
    """A hypothesis: the satellites it leaves out, the remaining statistic, its test, its cost J."""

    hypothesis: str
    subset: tuple[int, ...]
    statistic: float
    threshold: float
    cost: float

    @property
    def passes(self) -> bool:
        """Whether the remaining statistic passes its test."""
        return self.statistic <= self.threshold


def group_by_system(geometry: Vector) -> SystemGroups:
    """The systems among n satellites by their ranges' geometry (n, 20); none where there is only
    one system."""
    systems = systems_in_use(geometry).T
    if len(systems) < 2:
        return NO_SYSTEM_GROUPS
    shift = np.column_stack((geometry[:, :3], np.ones(len(geometry))))
    rows = tuple(tuple(row.nonzero()[0].tolist()) for row in systems)
    return SystemGroups(rows, systems[:, :, None] * shift)


def _freed_by_system(m: Vector, u: Vector, q: float, columns: Vector) -> tuple[float, float]:
    """The remaining statistics with the clock of a system freed, and with its position too;
    `columns` (n, 4) are the shift's."""
    clock, shifted = (freed_statistic(m, u, q, g) for g in (columns[:, 3:], columns))
    # A snapshot has solved for the clocks already.
    return clock, freed_statistic(m, u, q, columns[:, :3]) if shifted == q else shifted


def explain_by_systems(
    m: Vector, u: Vector, q: float, systems: SystemGroups, p_false_alarm: float
) -> list[Explanation]:
    """Each system shifted as a whole, or its clock alone; `m`, `u` and `q` as for satellites."""
    explanations = []
    for rows, columns in zip(systems.rows, systems.columns, strict=True):
        lefts, clock_left = _freed_by_system(m, u, q, columns), np.inf
        for (size, least, hypothesis), left in zip(FREED_PARAMETERS, lefts, strict=True):
            # A shift must explain what a clock fault does not.
            if len(rows) < least or clock_left - left < SHIFT_GAIN:
                continue
            clock_left = left
            threshold = chi_square_threshold(max(len(u) - size, 1), p_false_alarm)
            cost = left + PENALTY * size + SYSTEM_PENALTY
            subset = rows if hypothesis == "satellites" else ()
            explanations.append(Explanation(hypothesis, subset, left, threshold, cost))
    return explanations


def explain_by_small_systems(
    m: Vector, u: Vector, q: float, systems: SystemGroups, p_false_alarm: float
) -> list[Explanation]:
    """Each system too small to be isolated as a whole, left out: a rival all the same."""
    explanations, each = [], np.eye(len(u))
    for rows in systems.rows:
        size = len(rows)
        if size < LEAST_MOVED:
            left = freed_statistic(m, u, q, each[:, list(rows)])
            threshold = chi_square_threshold(max(len(u) - size, 1), p_false_alarm)
            cost = left + PENALTY * size + SYSTEM_PENALTY
            explanations.append(Explanation("satellites", rows, left, threshold, cost))
    return explanations


def leaves_out_system(best: Explanation, systems: SystemGroups) -> bool:
    """Whether an explanation leaves out a system, or all but one of its satellites: the last one
    fits anything by the system's clock."""
    out = set(best.subset)
    return len(out) > 1 and any(len(set(rows) - out) <= 1 for rows in systems.rows)


def is_ambiguous(best: Explanation, rivals: Sequence[Explanation]) -> bool:
    """Whether another system explains the innovations about as well as `best`."""
    # For a clock fault it does not matter which clock it is.
    return best.hypothesis != SYSTEM_CLOCK and any(
        rival.hypothesis == "satellites"
        and not set(rival.subset) & set(best.subset)
        and rival.cost - best.cost < LEAST_RATIO_LEAD
        for rival in rivals
    )
