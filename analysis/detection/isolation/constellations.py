"""Hypotheses of an entire faulty system, besides satellites, IMU and clock.

A spoofer of one system moves all its ranges along one shift of the position and one of the clock:
four parameters, however many satellites. A drifting system clock moves them along one. So a system
competes by rule D like the others, and healthy satellites of another are not excluded one by one.
Where the prediction cannot distinguish which of two systems moved, neither is used.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analysis.detection.statistics.bank import Indices, freed_statistic
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

PENALTY = 2.0  # per freed parameter, as in Akaike's criterion
SYSTEM_PENALTY = 6.0  # a system fails as a whole less often than one of its satellites
LEAST_MOVED, LEAST_CLOCK = 5, 3  # satellites of a system; with fewer anything can be explained
SYSTEM_CLOCK = "system-clock"
SYSTEMS_CONTRADICT = "two systems contradict each other; it is unknown which one is wrong"
FREED_PARAMETERS = ((1, LEAST_CLOCK, SYSTEM_CLOCK), (4, LEAST_MOVED, "satellites"))
SHIFT_GAIN = chi_square_threshold(3, 0.01)  # of three parameters more
SEPARABLE_COST = 10.0  # how much more a rival system must cost, or which one moved cannot be told


class SystemGroups(NamedTuple):
    """The satellites by system: the indices of each system's, and the effect of a system's shift
    of position (3) and clock on the innovations (systems, n, 4)."""

    rows: tuple[tuple[int, ...], ...]
    columns: Vector


NO_SYSTEM_GROUPS = SystemGroups((), np.empty((0, 0, 4)))


class Explanation(Value, frozen=True):
    """One hypothesis: the parameters it frees, the remaining statistic, and its threshold."""

    hypothesis: str
    subset: tuple[int, ...]
    statistic: float
    threshold: float
    cost: float

    @property
    def passes(self) -> bool:
        """Whether the remaining statistic fits the noise model."""
        return self.statistic <= self.threshold


def group_by_system(sight: Vector, offsets: Vector) -> SystemGroups:
    """The systems of n satellites, none if there is only one: `sight` (n, 3) is the effect of a
    position shift on their innovations, `offsets` (n, k) the effect of the systems' clock offsets.
    """
    # Contiguous, since a kernel is compiled anew for each memory layout.
    of, columns = _moved(np.ascontiguousarray(sight), np.ascontiguousarray(offsets))
    if len(columns) < 2:
        return NO_SYSTEM_GROUPS
    rows: list[list[int]] = [[] for _ in columns]
    for place, kind in enumerate(of.tolist()):
        rows[kind].append(place)
    return SystemGroups(tuple(map(tuple, rows)), columns)


@compiled
def _moved(sight: Vector, offsets: Vector) -> tuple[Indices, Vector]:
    """Index of each satellite's system (n,), and the columns of each system present (k, n, 4)."""
    count, most = offsets.shape
    system, seen = np.zeros(count, np.int64), np.zeros(most + 1, np.int64)
    for i in range(count):
        for k in range(most):
            # The first system's satellites have no offset.
            if offsets[i, k] != 0.0:
                system[i] += k + 1
        seen[system[i]] = 1
    kinds = 0
    for k in range(most + 1):
        here = seen[k]
        seen[k] = kinds
        kinds += here
    columns = np.zeros((kinds, count, 4))
    for i in range(count):
        system[i] = seen[system[i]]
        for axis in range(3):
            columns[system[i], i, axis] = sight[i, axis]
        columns[system[i], i, 3] = 1.0
    return system, columns


@compiled
def _freed_by_system(m: Vector, u: Vector, q: float, columns: Vector) -> Vector:
    """The statistics left (systems, 2) where the clock of each is freed, and where its position
    is too."""
    out = np.empty((columns.shape[0], 2))
    for k in range(columns.shape[0]):
        out[k, 0] = freed_statistic(m, u, q, np.ascontiguousarray(columns[k, :, 3:]))
        out[k, 1] = freed_statistic(m, u, q, np.ascontiguousarray(columns[k]))
        if out[k, 1] == q:  # a snapshot has solved for the clocks: the shift alone
            out[k, 1] = freed_statistic(m, u, q, np.ascontiguousarray(columns[k, :, :3]))
    return out


def explain_by_systems(
    m: Vector, u: Vector, q: float, systems: SystemGroups, p_false_alarm: float
) -> list[Explanation]:
    """Each system moved as a whole, or its clock alone; `m`, `u` and `q` as for satellites."""
    found = []
    remaining = _freed_by_system(m, u, q, systems.columns).tolist() if systems.rows else []
    for rows, lefts in zip(systems.rows, remaining, strict=True):
        clock_left = np.inf
        for (size, least, hypothesis), left in zip(FREED_PARAMETERS, lefts, strict=True):
            # A shift is believed where it explains what a clock that left cannot.
            if len(rows) < least or clock_left - left < SHIFT_GAIN:
                continue
            clock_left = left
            threshold = chi_square_threshold(max(len(u) - size, 1), p_false_alarm)
            cost = left + PENALTY * size + SYSTEM_PENALTY
            subset = rows if hypothesis == "satellites" else ()
            found.append(Explanation(hypothesis, subset, left, threshold, cost))
    return found


def explain_by_small_systems(
    m: Vector, u: Vector, q: float, systems: SystemGroups, p_false_alarm: float
) -> list[Explanation]:
    """Leaving out each system that is too small to be isolated; it still counts as a rival."""
    found, each = [], np.eye(len(u))
    for rows in systems.rows:
        size = len(rows)
        if size < LEAST_MOVED:
            left = freed_statistic(m, u, q, np.ascontiguousarray(each[:, list(rows)]))
            threshold = chi_square_threshold(max(len(u) - size, 1), p_false_alarm)
            cost = left + PENALTY * size + SYSTEM_PENALTY
            found.append(Explanation("satellites", rows, left, threshold, cost))
    return found


def leaves_out_system(best: Explanation, systems: SystemGroups) -> bool:
    """Whether an explanation leaves out a system, or several of one that has one more at most:
    that one fits anything by the system's clock."""
    out = set(best.subset)
    return len(out) > 1 and any(len(set(rows) - out) <= 1 for rows in systems.rows)


def is_ambiguous(best: Explanation, rivals: Sequence[Explanation]) -> bool:
    """Whether another system explains it about as well as the one that `best` leaves out."""
    # A clock that leaves harms nobody, whichever it is.
    return best.hypothesis != SYSTEM_CLOCK and any(
        rival.hypothesis == "satellites"
        and not set(rival.subset) & set(best.subset)
        and rival.cost - best.cost < SEPARABLE_COST
        for rival in rivals
    )
