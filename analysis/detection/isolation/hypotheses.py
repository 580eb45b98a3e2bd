"""Which hypothesis is faulty: satellites, a whole system, the prediction (IMU), the receiver clock.

Rule D of docs/fdi.md: of the explanations that pass their own test the one with the least cost
J = q_left + PENALTY * (number of freed parameters). Entire systems (constellations) compete like
the others ("Entire systems"), so healthy satellites of another one are not left out one by one.
Where it is ambiguous which of two systems moved, neither is used.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.measurement import systems_in_use
from analysis.detection.receiver.carry_off_windows import LEAST_RATIO_LEAD
from analysis.detection.statistics.bank import best_subset, freed_statistic
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector

LEAST_DOF_LEFT = 2  # after leaving out: with one, too many wrong sets pass
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


def explain(
    hypothesis: str,
    subset: tuple[int, ...],
    left: float,
    dof: tuple[int, int],
    p_false_alarm: float,
    penalty: float = 0.0,
) -> Explanation:
    """The explanation that leaves the statistic `left`; `dof` are the measurements, and how many
    parameters are freed."""
    count, freed = dof
    # At least one degree: with none the threshold would be NaN and nothing would pass.
    threshold = chi_square_threshold(max(count - freed, 1), p_false_alarm)
    cost = left + PENALTY * freed + penalty
    return Explanation(hypothesis, subset, left, threshold, cost)


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
            clock_left, dof = left, (len(u), size)
            subset = rows if hypothesis == "satellites" else ()
            explanations.append(
                explain(hypothesis, subset, left, dof, p_false_alarm, SYSTEM_PENALTY)
            )
    return explanations


def explain_by_small_systems(
    m: Vector, u: Vector, q: float, systems: SystemGroups, p_false_alarm: float
) -> list[Explanation]:
    """Each system too small to be isolated as a whole, left out: a rival all the same."""
    explanations, each = [], np.eye(len(u))
    for rows in systems.rows:
        if len(rows) < LEAST_MOVED:
            left, dof = freed_statistic(m, u, q, each[:, list(rows)]), (len(u), len(rows))
            explanations.append(
                explain("satellites", rows, left, dof, p_false_alarm, SYSTEM_PENALTY)
            )
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


class IsolationVerdict(Value, frozen=True):
    """The selected hypothesis, the satellites it leaves out, and the relative likelihoods of all;
    `whole_system` says that it is about a system as a whole."""

    hypothesis: str
    subset: tuple[int, ...]
    probabilities: dict[str, float]
    whole_system: bool = False


def explain_by_satellites(
    m: Vector, u: Vector, q: float, p_false_alarm: float, largest: int, unknowns: int = 0
) -> Explanation | None:
    """The smallest set of satellites whose exclusion passes the test; None above `largest`.

    A set that passes is still enlarged while one satellite more lowers the statistic by more than a
    healthy one does with probability `p_false_alarm`: the test of the rest can miss a second fault
    that a test of its own detects. `unknowns` is how many parameters `m` has
    been projected off (0 for innovations of a filter, 4 or 5 for a snapshot). `m` (n, n) is the
    inverse covariance of the innovations v, `u` (n,) is m v.
    """
    count = len(u)
    found: Explanation | None = None
    # Shared among the satellites that might be added.
    significant = chi_square_threshold(1, p_false_alarm / count)
    for size in range(1, min(largest, count - unknowns - LEAST_DOF_LEFT) + 1):
        statistic, pick = best_subset(m, u, q, size)
        # Shared evenly among all sets of that size (Bonferroni's bound): the right one passes with
        # the configured probability whichever it is.
        p = p_false_alarm / math.comb(count, size)
        threshold = chi_square_threshold(count - unknowns - size, p)
        # Once the next satellite is not significant the smaller set is the verdict.
        if found is not None and found.statistic - statistic <= significant:
            return found
        if statistic <= threshold:
            subset = tuple(pick.tolist())
            cost = statistic + PENALTY * size
            found = Explanation("satellites", subset, statistic, threshold, cost)
    return found


def select_hypothesis(
    m: Vector,
    v: Vector,
    position: Vector,
    clock: Vector,
    p_false_alarm: float,
    largest: int,
    rule: str = "explicit",
    systems: SystemGroups = NO_SYSTEM_GROUPS,
) -> IsolationVerdict:
    """The verdict on innovations that failed the main test.

    Parameters
    ----------
    m : (n, n), inverse of the innovation covariance
    v : (n,), innovations
    position : (n, 3), what a position error does to them
    clock : (n, 1), what a clock jump does to them
    p_false_alarm : float
        Of the main test.
    largest : int
        Most satellites to leave out.
    rule : {"explicit", "plain"}
    systems : the satellites of each system, where there are two at least
    """
    u = m @ v
    q = float(v @ u)
    satellites = explain_by_satellites(m, u, q, p_false_alarm, largest)
    # The older rule, for comparison: it never considers the clock.
    if rule == "plain":
        if satellites is None:
            return IsolationVerdict("imu", (), {"imu": 1.0})
        return IsolationVerdict("satellites", satellites.subset, {"satellites": 1.0})
    rivals = [
        explain(name, (), freed_statistic(m, u, q, g), (len(u), g.shape[1]), p_false_alarm)
        for name, g in (("imu", position), ("clock", clock))
    ]
    moved = explain_by_systems(m, u, q, systems, p_false_alarm)
    rivals += moved
    if satellites is not None:
        rivals.append(satellites)
    passing = [rival for rival in rivals if rival.passes]
    probabilities = _probabilities(rivals, q, chi_square_threshold(len(u), p_false_alarm))
    if not passing:
        return IsolationVerdict("multiple-unknown", (), probabilities)
    # Least J: the unexplained rest, and a penalty for what was freed.
    best = min(passing, key=lambda rival: rival.cost)
    if leaves_out_system(best, systems):
        few = explain_by_small_systems(m, u, q, systems, p_false_alarm)
        if is_ambiguous(best, [*moved, *few]):
            return IsolationVerdict("multiple-unknown", (), probabilities, True)
    return IsolationVerdict(best.hypothesis, best.subset, probabilities, best in moved)


def _probabilities(rivals: list[Explanation], q: float, threshold: float) -> dict[str, float]:
    """Relative likelihoods exp(-J/2); "multiple-unknown" explains all but for its threshold."""
    costs: dict[str, float] = {}
    for rival in rivals:
        costs[rival.hypothesis] = min(rival.cost, costs.get(rival.hypothesis, rival.cost))
    costs["none"] = q
    # As if it freed three parameters, like a wrong position.
    costs["multiple-unknown"] = threshold + 3.0 * PENALTY
    # Relative to the least, or the exponentials would all underflow to zero.
    least = min(costs.values())
    weights = {name: math.exp(-0.5 * (cost - least)) for name, cost in costs.items()}
    total = sum(weights.values())
    return {name: weight / total for name, weight in sorted(weights.items())}
