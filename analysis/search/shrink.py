"""Shrink a worst case to the smallest fault that still breaks the estimator.

Each fault's value and duration in turn is reduced toward no fault while the mean error over fresh
noise stays at the limit. The error need not grow monotonically with a fault, so a grid is
evaluated, then a finer one in the interval where the estimator breaks.
"""

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.search.evaluation.evaluator import make_evaluator
from analysis.search.space.dimensions import target_of
from analysis.search.space.fault_range import healthy_value
from analysis.search.space.test_file import (
    InitialState,
    Mission,
    SearchControls,
    SearchSensors,
    SteadyWind,
    TestFile,
)

Array = NDArray[np.float64]
KERNEL_GRID, SIMULATOR_GRID = 12, 4  # grid points; flights in the simulator are slow
ROUNDS = 2  # a grid and one refinement


def pin_values(test: TestFile, values: Mapping[str, float]) -> TestFile:
    """The test with every range replaced by its value: a file that repeats this case."""

    def part(section: str) -> dict[str, float]:
        head = section + "."
        return {k.removeprefix(head): float(v) for k, v in values.items() if k.startswith(head)}

    faults = []
    for i, fault in enumerate(test.faults):
        own = part(f"faults[{i}]")
        target = target_of(test, i, own.pop("target"))
        faults.append(msgspec.structs.replace(fault, target=target, any_of=[], **own))
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
    """Names of the values to shrink, in order."""
    return [
        f"faults[{i}].{key}"
        for i, fault in enumerate(test.faults)
        for key in fault.ranges()
        # The onset is no measure of a fault's size.
        if key != "at_s"
    ]


def scale_toward_none(test: TestFile, name: str, value: float, share: Array) -> Array:
    """Values (n,) between no fault (share 0) and `value` (share 1)."""
    index = int(name[len("faults[") : name.index("]")])
    healthy = healthy_value(test.faults[index].fault) if name.endswith(".value") else 0.0
    if name.endswith(".for_s"):
        # A fault beyond the end of the flight is limited to the flight.
        value = min(value, test.duration_s)
    return healthy + share * (value - healthy)


def shrink_faults(
    test: TestFile,
    values: Mapping[str, float],
    limit_deg: float,
    errors_deg: "MeanErrors",
) -> dict[str, float]:
    """The values with the smallest faults found; `errors_deg` gives mean errors of cases."""
    smallest = dict(values)
    grid = SIMULATOR_GRID if test.simulated else KERNEL_GRID
    for name in fault_names(test):
        low, high = 0.0, 1.0
        for _ in range(ROUNDS):
            # Without the last point, the case itself, which is known to break.
            share = np.linspace(low, high, grid + 1)[:-1]
            candidates = [
                smallest | {name: float(v)}
                for v in scale_toward_none(test, name, smallest[name], share)
            ]
            broken = errors_deg(candidates) >= limit_deg
            if not broken.any():
                low = float(share[-1])
                continue
            # The first that breaks; larger values need not all break.
            k = int(np.argmax(broken))
            high = float(share[k])
            low = float(share[k - 1]) if k else high
            # Even no fault breaks: this fault is not the cause.
            if k == 0:
                break
        smallest[name] = float(scale_toward_none(test, name, smallest[name], np.array([high]))[0])
    return smallest


class MeanErrors:
    """Mean errors in degrees of several cases with the same noise; -inf outside the envelope."""

    def __init__(self, test: TestFile, seed: int, draws: int) -> None:
        self._test, self._seed, self._draws = test, seed, draws

    def __call__(self, cases: list[dict[str, float]]) -> Array:
        # The same noise for all cases: only the faults differ.
        columns = {name: np.array([case[name] for case in cases]) for name in cases[0]}
        flown = make_evaluator(self._test)
        outcome = flown.evaluate_values(columns, self._seed, 0, self._draws, True)
        return np.where(outcome.broken_limit > 0, -np.inf, outcome.fitness)
