"""Whole systems as hypotheses beside satellites, IMU and clock.

A spoofer of one system moves all its ranges along one shift of the position and one of the clock:
four parameters, however many satellites. A system's clock that leaves moves them along one. So a
system competes by rule D as they do, and healthy satellites of another are not left out one by one.
Where the prediction cannot tell which of two systems moved, neither is believed.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analysis.detection.isolation.bank import freed
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.values import Value
from analysis.samples.sample import Vector

PENALTY = 2.0  # per freed parameter, as in Akaike's criterion
SYSTEM_PENALTY = 6.0  # a system fails as a whole less often than one of its satellites
LEAST_MOVED, LEAST_CLOCK = 5, 3  # satellites of a system; with fewer anything can be explained
SYSTEM_CLOCK = "system-clock"
CONTRADICTION = "two systems contradict each other, and nothing tells which one is wrong"
FREED = ((1, LEAST_CLOCK, SYSTEM_CLOCK), (4, LEAST_MOVED, "satellites"))
NEWS = chi_square(3, 0.01)  # of three parameters more
TELLING = 10.0  # how much more a rival system must cost, or which one moved cannot be told


class Group(NamedTuple):
    """The satellites of one system: their places, and what a shift of position (3) and clock does
    to the innovations (n, 4)."""

    rows: tuple[int, ...]
    columns: Vector


class Explanation(Value, frozen=True):
    """One hypothesis: what it frees, the statistic left, and whether that passes its test."""

    hypothesis: str
    subset: tuple[int, ...]
    statistic: float
    threshold: float
    cost: float

    @property
    def passes(self) -> bool:
        """Whether what is left fits the noise model."""
        return self.statistic <= self.threshold


def groups_of(sight: Vector, offsets: Vector) -> tuple[Group, ...]:
    """The systems among n satellites: `sight` (n, 3) is what a shift of position does to their
    innovations, `offsets` (n, k) what the systems' clock offsets do; none where there is only one.
    """
    system = (offsets != 0.0) @ np.arange(1, offsets.shape[1] + 1)
    of = system.tolist()
    kinds = sorted(set(of))
    if len(kinds) < 2:
        return ()
    moved = np.ones((len(of), 4))
    moved[:, :3] = sight
    return tuple(
        Group(
            tuple(i for i, one in enumerate(of) if one == kind), moved * (system == kind)[:, None]
        )
        for kind in kinds
    )


def explain_by_systems(
    m: Vector, u: Vector, q: float, systems: Sequence[Group], p_false_alarm: float
) -> list[Explanation]:
    """Each system moved as a whole, or its clock alone; `m`, `u` and `q` as for satellites."""
    found = []
    for group in systems:
        clock_left = np.inf
        for size, least, hypothesis in FREED:
            left = freed(m, u, q, np.ascontiguousarray(group.columns[:, 4 - size :]))
            if size > 1 and left == q:  # a snapshot has solved for the clocks: the shift alone
                left = freed(m, u, q, np.ascontiguousarray(group.columns[:, :3]))
            # A shift is believed where it explains what a clock that left cannot.
            if len(group.rows) < least or clock_left - left < NEWS:
                continue
            clock_left = left
            threshold = chi_square(max(len(u) - size, 1), p_false_alarm)
            cost = left + PENALTY * size + SYSTEM_PENALTY
            subset = group.rows if hypothesis == "satellites" else ()
            found.append(Explanation(hypothesis, subset, left, threshold, cost))
    return found


def ambiguous(best: Explanation, rivals: Sequence[Explanation]) -> bool:
    """Whether another system explains it about as well as the one that `best` leaves out."""
    # A clock that leaves harms nobody, whichever it is.
    return best.hypothesis != SYSTEM_CLOCK and any(
        rival.hypothesis == "satellites"
        and not set(rival.subset) & set(best.subset)
        and len(rival.subset) >= LEAST_MOVED
        and rival.cost - best.cost < TELLING
        for rival in rivals
    )
