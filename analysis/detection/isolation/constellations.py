"""Entire systems (constellations) as hypotheses beside satellites, IMU and clock.

A spoofer of one system moves all its ranges by one shift of the position and one of the clock: four
parameters, however many satellites. A fault of a system's clock moves them by one. So a system
competes by rule D like the other hypotheses, and healthy satellites of another system are not left
out one by one. Where it is ambiguous which of two systems moved, neither is used.
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
LEAST_MOVED, LEAST_CLOCK = 5, 3  # satellites of a system: one more than its parameters, two
SYSTEM_CLOCK = "system-clock"
SYSTEMS_CONTRADICT = "two systems contradict each other, and it is ambiguous which one is wrong"
FREED_PARAMETERS = ((1, LEAST_CLOCK, SYSTEM_CLOCK), (4, LEAST_MOVED, "satellites"))
SHIFT_GAIN = chi_square_threshold(3, 0.01)  # that three more parameters gain by chance in 1 %
SEPARABLE_COST = 10.0  # a rival's additional J, or it is ambiguous: likelihoods 150 to 1


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


def group_by_system(line_of_sight: Vector, offsets: Vector) -> SystemGroups:
    """The systems among n satellites, by what a shift of position (n, 3) and the systems' clock
    offsets (n, k) do to their innovations; none where there is only one system."""
    # Contiguous, since a kernel is compiled anew for each memory layout.
    of, columns = _columns(np.ascontiguousarray(line_of_sight), np.ascontiguousarray(offsets))
    if len(columns) < 2:
        return NO_SYSTEM_GROUPS
    rows: list[list[int]] = [[] for _ in columns]
    for place, kind in enumerate(of.tolist()):
        rows[kind].append(place)
    return SystemGroups(tuple(map(tuple, rows)), columns)


@compiled
def _columns(line_of_sight: Vector, offsets: Vector) -> tuple[Indices, Vector]:
    """The system of each satellite (n,), numbered by those in use, and the columns of each."""
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
            columns[system[i], i, axis] = line_of_sight[i, axis]
        columns[system[i], i, 3] = 1.0
    return system, columns


@compiled
def _freed_by_system(m: Vector, u: Vector, q: float, columns: Vector) -> Vector:
    """The remaining statistics (systems, 2) with the clock of each system freed, and with its
    position freed too."""
    out = np.empty((columns.shape[0], 2))
    for k in range(columns.shape[0]):
        out[k, 0] = freed_statistic(m, u, q, np.ascontiguousarray(columns[k, :, 3:]))
        out[k, 1] = freed_statistic(m, u, q, np.ascontiguousarray(columns[k]))
        if out[k, 1] == q:  # a snapshot has solved for the clocks already
            out[k, 1] = freed_statistic(m, u, q, np.ascontiguousarray(columns[k, :, :3]))
    return out


def explain_by_systems(
    m: Vector, u: Vector, q: float, systems: SystemGroups, p_false_alarm: float
) -> list[Explanation]:
    """Each system shifted as a whole, or its clock alone; `m`, `u` and `q` as for satellites."""
    explanations = []
    remaining = _freed_by_system(m, u, q, systems.columns).tolist() if systems.rows else []
    for rows, lefts in zip(systems.rows, remaining, strict=True):
        clock_left = np.inf
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
            left = freed_statistic(m, u, q, np.ascontiguousarray(each[:, list(rows)]))
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
        and rival.cost - best.cost < SEPARABLE_COST
        for rival in rivals
    )
