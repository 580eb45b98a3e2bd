"""Shrink a case to the smallest faults with which it still breaks the estimator or a requirement.

Delta debugging [1]_: faults are dropped, then the value and duration of each in turn is reduced
toward no fault. The error need not grow monotonically with a fault, so the compiled kernels
evaluate a grid, then a finer one in the interval where the case breaks; slow flights bisect.

References
----------
.. [1] Zeller and Hildebrandt, IEEE Transactions on Software Engineering 28(2), 2002.
"""

from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.search.evaluation.evaluation_job import make_evaluator
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
Values = dict[str, float]
Breaks = Callable[[list[Values]], Sequence[bool] | NDArray[np.bool_]]  # which of some cases break
# Intervals of a grid, and refinements; chosen: to 1/144, and to 1/8 in three slow flights.
KERNEL_GRID, SIMULATOR_GRID = (12, 2), (2, 3)


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


def drop_faults(test: TestFile, values: Mapping[str, float], breaks: Breaks) -> Values:
    """The values with zero duration for each fault without which the case still breaks."""
    fewer = dict(values)
    for i in range(len(test.faults)):
        absent = fewer | {f"faults[{i}].for_s": 0.0}
        fewer = absent if breaks([absent])[0] else fewer
    return fewer


def shrink_faults(test: TestFile, values: Mapping[str, float], breaks: Breaks) -> Values:
    """The values with the smallest magnitudes and durations found that still break."""
    smallest = dict(values)
    grid, rounds = SIMULATOR_GRID if test.simulated else KERNEL_GRID
    for name in fault_names(test):
        # A dropped fault has no size.
        if smallest.get(f"{name.partition('.')[0]}.for_s") == 0.0:
            continue
        low, high = 0.0, 1.0
        for _ in range(rounds):
            share = np.linspace(low, high, grid + 1)
            scaled = scale_toward_none(test, name, values[name], share)
            # The ends are known. The first that breaks; larger values need not all break.
            broken = breaks([smallest | {name: float(value)} for value in scaled[1:-1]])
            k = 1 + int(np.argmax([*broken, True]))
            low, high = float(share[k - 1]), float(share[k])
        smallest[name] = float(scale_toward_none(test, name, values[name], np.array([high]))[0])
    return smallest


def mean_errors(test: TestFile, cases: Sequence[Values], seed: int) -> Array:
    """Mean errors of cases with the same noise; -inf outside the envelope."""
    # The same noise for all cases: only the faults differ.
    columns = {name: np.array([case[name] for case in cases]) for name in cases[0]}
    evaluator = make_evaluator(test)
    outcome = evaluator.evaluate_values(columns, seed, 0, test.noise_draws, True)
    return np.where(outcome.broken_limit > 0, -np.inf, outcome.fitness)
