"""Which hypothesis is faulty: satellites, the prediction (IMU), the receiver clock, or unknown.

Rule D of docs/fdi.md: of the explanations that pass their own test the one with the least cost
J = q_left + PENALTY * (number of freed parameters).
"""

import math

from analysis.detection.isolation.constellations import (
    NO_SYSTEM_GROUPS,
    PENALTY,
    Explanation,
    SystemGroups,
    explain_by_small_systems,
    explain_by_systems,
    is_ambiguous,
    leaves_out_system,
)
from analysis.detection.statistics.bank import best_subset, freed_statistic
from analysis.detection.statistics.chi_square import chi_square_threshold, subset_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector

LEAST_DOF_LEFT = 2  # after leaving out: with one, too many wrong sets pass


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
        threshold = subset_threshold(count, size, p_false_alarm, unknowns)
        # Once the next satellite is not significant the smaller set is the verdict.
        if found is not None and found.statistic - statistic <= significant:
            return found
        if statistic <= threshold:
            subset = tuple(pick.tolist())
            cost = statistic + PENALTY * size
            found = Explanation("satellites", subset, statistic, threshold, cost)
    return found


def explain_by_parameters(
    hypothesis: str, m: Vector, u: Vector, q: float, g: Vector, p_false_alarm: float
) -> Explanation:
    """The explanation that frees parameters along the columns of g (n, k)."""
    size = g.shape[1]
    statistic = freed_statistic(m, u, q, g)
    # At least one degree: with none the threshold would be NaN and nothing would pass.
    threshold = chi_square_threshold(max(len(u) - size, 1), p_false_alarm)
    return Explanation(hypothesis, (), statistic, threshold, statistic + PENALTY * size)


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
        explain_by_parameters("imu", m, u, q, position, p_false_alarm),
        explain_by_parameters("clock", m, u, q, clock, p_false_alarm),
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
