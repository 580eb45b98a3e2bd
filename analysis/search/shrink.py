"""Make a worst case smaller: the least fault that still breaks the estimator.

One after the other each fault's value and duration are brought towards no fault at all, as far as
the mean error over fresh noise stays at the limit. The error need not grow evenly with a fault, so
that a grid is tried, then a finer one within the cell where the estimator breaks.
"""

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.search.evaluation.evaluator import make_evaluator
from analysis.search.space.dimensions import target_of
from analysis.search.space.test_file import (
    InitialState,
    Mission,
    SearchControls,
    SearchSensors,
    SteadyWind,
    TestFile,
)

Array = NDArray[np.float64]
KERNEL_GRID, SIMULATOR_GRID = 12, 4  # of flights in the kernels, and of those in the simulator
ROUNDS = 2


def pin_values(test: TestFile, values: Mapping[str, float]) -> TestFile:
    """The test with every range replaced by its value: a file that flies this case again."""

    def part(section: str) -> dict[str, float]:
        head = section + "."
        return {k.removeprefix(head): float(v) for k, v in values.items() if k.startswith(head)}

    faults = []
    for i, fault in enumerate(test.faults):
        mine = part(f"faults[{i}]")
        target = target_of(test, i, mine.pop("target"))
        faults.append(msgspec.structs.replace(fault, target=target, any_of=[], **mine))
    return msgspec.structs.replace(
        test,
        initial=InitialState(**part("initial")),
        controls=SearchControls(**part("controls")),
        mission=Mission(**part("mission")) if test.mission is not None else None,
        wind=SteadyWind(**part("wind")),
        sensors=SearchSensors(**part("sensors")),
        vary={name: (value, value) for name, value in part("vary").items()},
        faults=faults,
    )


def fault_names(test: TestFile) -> list[str]:
    """What shrinking works on, in order."""
    return [
        f"faults[{i}].{key}"
        for i, fault in enumerate(test.faults)
        for key in fault.ranges()
        # When a fault begins is no measure of its size.
        if key != "at_s"
    ]


def scale_toward_none(test: TestFile, name: str, value: float, share: Array) -> Array:
    """Values (n,) between no fault (share 0) and `value` (share 1)."""
    index = int(name[len("faults[") : name.index("]")])
    scale = test.faults[index].fault == "scale" and name.endswith(".value")
    # The neutral element of a scale is one, of everything else zero.
    healthy = 1.0 if scale else 0.0
    if name.endswith(".for_s"):
        # A fault that lasts beyond the flight is no longer than the flight.
        value = min(value, test.duration_s)
    return healthy + share * (value - healthy)


def shrink_faults(
    test: TestFile,
    values: Mapping[str, float],
    limit_deg: float,
    errors_deg: "MeanErrors",
) -> dict[str, float]:
    """The values of the smallest fault found; `errors_deg` gives the mean error of many."""
    found = dict(values)
    grid = SIMULATOR_GRID if test.simulated else KERNEL_GRID
    for name in fault_names(test):
        low, high = 0.0, 1.0
        for _ in range(ROUNDS):
            # Without the last point: that is the case itself, known to break.
            share = np.linspace(low, high, grid + 1)[:-1]
            tried = [
                found | {name: float(v)} for v in scale_toward_none(test, name, found[name], share)
            ]
            broken = errors_deg(tried) >= limit_deg
            if not broken.any():
                low = float(share[-1])
                continue
            # The first that breaks; what lies above it need not all break.
            k = int(np.argmax(broken))
            high = float(share[k])
            low = float(share[k - 1]) if k else high
            # Even no fault breaks: the fault is not what breaks the estimator.
            if k == 0:
                break
        found[name] = float(scale_toward_none(test, name, found[name], np.array([high]))[0])
    return found


class MeanErrors:
    """Mean error in degrees of several cases, with the same noise for all; -inf if one leaves."""

    def __init__(self, test: TestFile, seed: int, draws: int) -> None:
        self._test, self._seed, self._draws = test, seed, draws

    def __call__(self, cases: list[dict[str, float]]) -> Array:
        # The same noise for all cases: differences are then those of the faults.
        columns = {name: np.array([case[name] for case in cases]) for name in cases[0]}
        flown = make_evaluator(self._test)
        outcome = flown.evaluate_values(columns, self._seed, 0, self._draws, True)
        return np.where(outcome.broken_limit > 0, -np.inf, outcome.fitness)
