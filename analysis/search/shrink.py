"""Shrink a case to the smallest faults with which it still breaks the estimator or a requirement.

Delta debugging [1]_: faults are dropped, then the value and duration of each in turn is reduced
toward no fault, by bisection; the error need not grow monotonically with a fault, so a smaller one
may break too.

References
----------
.. [1] Zeller and Hildebrandt, IEEE Transactions on Software Engineering 28(2), 2002.
"""

from collections.abc import Callable, Mapping
from functools import partial

import msgspec
import numpy as np

from analysis.search.evaluation.evaluator import Evaluator, average_draws
from analysis.search.space.dimensions import section_values, target_of
from analysis.search.space.fault_range import healthy_value
from analysis.search.space.test_file import (
    InitialState,
    Mission,
    SearchControls,
    SearchSensors,
    SteadyWind,
    TestFile,
)

Values = dict[str, float]
Breaks = Callable[[Values], bool]  # whether a case breaks
COMPILED_ROUNDS, PROXIED_ROUNDS = 7, 3  # halvings; chosen: to 1/128, and to 1/8 in slow flights


def pin_values(test: TestFile, values: Mapping[str, float]) -> TestFile:
    """The test with every range replaced by its value: a file that repeats this case."""
    part = partial(section_values, values)
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


def scale_toward_none(test: TestFile, name: str, value: float, share: float) -> float:
    """The value between no fault (share 0) and `value` (share 1)."""
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
        fewer = absent if breaks(absent) else fewer
    return fewer


def shrink_faults(test: TestFile, values: Mapping[str, float], breaks: Breaks) -> Values:
    """The values with the smallest magnitudes and durations found that still break."""
    smallest = dict(values)
    for name in fault_names(test):
        # A dropped fault has no size.
        if smallest.get(f"{name.partition('.')[0]}.for_s") == 0.0:
            continue
        low, high = 0.0, 1.0
        for _ in range(PROXIED_ROUNDS if test.simulated else COMPILED_ROUNDS):
            middle = 0.5 * (low + high)
            scaled = scale_toward_none(test, name, values[name], middle)
            low, high = (low, middle) if breaks(smallest | {name: scaled}) else (middle, high)
        smallest[name] = scale_toward_none(test, name, values[name], high)
    return smallest


def mean_error(test: TestFile, case: Values, seed: int) -> float:
    """The mean error of a case, with the same noise for all cases; -inf outside the envelope."""
    draws = test.noise_draws
    flights = [Evaluator(test).scores(case, seed, draw) for draw in range(draws)]
    outcome = average_draws(flights, draws, test.duration_s)
    return -np.inf if outcome.broken_limit[0] > 0 else float(outcome.fitness[0])
