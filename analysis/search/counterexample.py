"""Reduce a flight that violates a requirement to the simplest one that still does, and write it.

Delta debugging [1]_: faults are dropped, varied values of the scenario set back, then durations and
magnitudes reduced, as long as the flight violates the requirement. The result is flown again.

References
----------
.. [1] Zeller and Hildebrandt, IEEE Transactions on Software Engineering 28(2), 2002.
"""

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.log_report import write_report
from analysis.report.recordings.flight_sources import read_flight
from analysis.search.archive import Case
from analysis.search.evaluation.simulated_batch import SimulatedBatch
from analysis.search.evaluation.violation import fly_violation
from analysis.search.lanes.noise_kernel import seed_of
from analysis.search.shrink import fault_names, scale_toward_none
from analysis.search.space.fault_picks import expand_picks
from analysis.search.space.point_scenario import document_of
from analysis.search.space.test_file import TestFile
from mavproxy_fault.app.recorder import LABELS, SENT
from mavproxy_fault.documents.yaml_document import without_none, write_yaml
from mavproxy_fault.wire.label import read_labels

HALVINGS = 3  # chosen: to an eighth of a magnitude and of a duration, three flights each
Values = dict[str, float]


class Counterexample(msgspec.Struct, frozen=True, kw_only=True):
    """A reduced counterexample: its faults, how many of the repeated flights violated the
    requirement, what the subject did, and the command that flies it again."""

    violation: str
    faults: list[dict[str, Any]]
    flown: int
    failed: int
    behaviour: str
    flights: int
    command: str

    @property
    def likeness(self) -> tuple[str, ...]:
        """What alike counterexamples share: the behaviour, and kinds and targets of the faults."""
        kinds = (f"{fault['fault']} {fault['target']}" for fault in self.faults)
        return self.behaviour, *sorted(kinds)

    def describe(self) -> str:
        """Return the counterexample in some lines."""
        lines = [f"{self.violation}; in {self.failed} of {self.flown} flights"]
        lines += [f"  {shlex.join(f'{k}={v}' for k, v in fault.items())}" for fault in self.faults]
        lines += [f"  {self.behaviour}"] if self.behaviour else []
        return "\n".join([*lines, f"  {self.command}"])


class _Flights:
    """Flights of one case; `count` are those flown so far."""

    def __init__(self, seed: int, number: int) -> None:
        self.seed, self.number, self.count = seed, number, 0

    def violates(self, test: TestFile, values: Mapping[str, float]) -> bool:
        """Fly, and return whether the requirement is violated."""
        self.count += 1
        scores = SimulatedBatch(test).scores(values, self.seed, self.number)
        return bool(scores.rmse_deg[0] > 0.0)


def reduce_case(test: TestFile, case: Case, folder: Path) -> Counterexample:
    """Reduce a case, fly it `rescore_draws` times, and write it to a folder."""
    point = SimulatedBatch(test).space.values(case.point[None, :])
    values: Mapping[str, float] = {name: float(value[0]) for name, value in point.items()}
    test, values = expand_picks(test, values)
    flights = _Flights(test.seed, case.number)
    test, values = _drop_faults(test, dict(values), flights)
    for name, value in _simpler_values(test, values):
        if flights.violates(test, changed := values | {name: value}):
            values = changed
    for name in fault_names(test):
        values = _halve(test, values, name, flights)
    # Other noise each time; an autopilot's flights differ anyway.
    numbers = range(case.number, case.number + test.rescore_draws)
    failed = sum(_Flights(test.seed, number).violates(test, values) for number in numbers)
    document = document_of(test, values, seed_of(test.seed, case.number))
    found, flight = fly_violation(test, document, folder / "with")
    calm = {**document, "schedule": {**document["schedule"], "faults": []}}
    fly_violation(test, calm, folder / "without")
    write_curves(test, folder)
    return Counterexample(
        violation=f"{found.name}: {found.describe()}", faults=document["schedule"]["faults"],
        flown=len(numbers), failed=failed, behaviour=flight.behaviour,
        flights=flights.count + len(numbers) + 2, command=write_scenario(test, document, folder),
    )  # fmt: skip


def _drop_faults(test: TestFile, values: Values, flights: _Flights) -> tuple[TestFile, Values]:
    """Drop the faults without which the requirement is still violated."""
    for i in reversed(range(len(test.faults))):
        kept = [j for j in range(len(test.faults)) if j != i]
        fewer = {k: v for k, v in values.items() if not k.startswith("faults[")}
        for new, old in enumerate(kept):
            head = f"faults[{old}]."
            fewer |= {
                f"faults[{new}].{k.removeprefix(head)}": v
                for k, v in values.items() if k.startswith(head)
            }  # fmt: skip
        smaller = msgspec.structs.replace(test, faults=[test.faults[j] for j in kept])
        if flights.violates(smaller, fewer):
            test, values = smaller, fewer
    return test, values


def _simpler_values(test: TestFile, values: Values) -> Iterator[tuple[str, float]]:
    """Varied values of the scenario, such as the wind, and what they are without the search."""
    for name in test.vary:
        own: Any = test.scenario
        for part in name.replace("]", "").replace("[", ".").split("."):
            own = own[int(part)] if part.isdigit() else own[part]
        if isinstance(own, int | float) and values[f"vary.{name}"] != own:
            yield f"vary.{name}", float(own)


def _halve(test: TestFile, values: Values, name: str, flights: _Flights) -> Values:
    """Reduce a magnitude or a duration toward no fault by bisection."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS if name in values else 0):
        middle = 0.5 * (low + high)
        (value,) = scale_toward_none(test, name, values[name], np.array([middle]))
        violated = flights.violates(test, values | {name: float(value)})
        low, high = (low, middle) if violated else (middle, high)
    if high == 1.0:
        return values
    return values | {name: float(scale_toward_none(test, name, values[name], np.array([high]))[0])}


def write_scenario(test: TestFile, document: Mapping[str, Any], folder: Path) -> str:
    """Write scenario and schedule; return the command that flies them."""
    schedule = {"seed": document["seed"], "faults": document["schedule"]["faults"]}
    scenario = {key: value for key, value in document.items() if key != "schedule"}
    (folder / "scenario.yaml").write_text(write_yaml(without_none(scenario)))
    (folder / "schedule.yaml").write_text(write_yaml(schedule))
    words = ["mavproxy-fault", "run", str(folder / "scenario.yaml")]
    words += ["--schedule", str(folder / "schedule.yaml")]
    if test.autopilot is not None:
        words += ["--autopilot", test.autopilot.kind]
        for option in ("binary", "parameters"):
            value = getattr(test.autopilot, option)
            words += [f"--{option}", value] if value is not None else []
    return shlex.join(words)


def write_curves(test: TestFile, folder: Path) -> None:
    """Write `report.html` of the flight with the faults, with the curves of that without them."""
    logs = [next((folder / side).rglob(SENT)) for side in ("with", "without")]
    labels = read_labels(logs[0].parent / LABELS)
    thresholds = Thresholds(requirements=[msgspec.to_builtins(test.requirement)])
    flown = assess_flight(read_flight(logs[:1], labels), thresholds)
    write_report(folder, flown, [assess_flight(read_flight(logs[1:], ()), thresholds)])
