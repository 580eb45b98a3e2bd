"""Reduce a flight that violates a requirement to the simplest one that still does, and write it.

Faults are dropped, varied values of the scenario set back, then magnitudes and durations reduced,
as long as the flight violates the requirement. The result is flown again.
"""

import shlex
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.log_report import write_report
from analysis.report.recordings.flight_sources import read_flight
from analysis.search.archive import Case
from analysis.search.evaluation.evaluator import Evaluator, seed_of
from analysis.search.evaluation.point_flight import fly_point, schedule_of, write_scenario
from analysis.search.shrink import Values, drop_faults, shrink_faults
from analysis.search.space.fault_picks import expand_picks
from analysis.search.space.point_scenario import document_of
from analysis.search.space.test_file import TestFile
from mavproxy_fault.app.recorder import LABELS, SENT
from mavproxy_fault.documents.yaml_document import write_yaml
from mavproxy_fault.wire.label import read_labels

STEADY = 0.8  # chosen: violates in four of five flights


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
    """Flights of a case that is reduced: `count` so far, and the `violating` ones in order."""

    def __init__(self, test: TestFile, number: int, values: Values) -> None:
        self.test, self.number, self.count, self.violating = test, number, 0, [values]

    def violate(self, values: Values) -> bool:
        """Fly a case with the noise of the search; return whether it violates the requirement."""
        found = self.fly(values, self.number)
        self.violating += [values] if found else []
        return found

    def fly(self, values: Values, number: int) -> bool:
        """Fly with the noise of a number; return whether the requirement is violated."""
        self.count += 1
        return Evaluator(self.test).scores(values, self.test.seed, number).error > 0.0

    def repeat(self) -> tuple[Values, int]:
        """Return the most reduced values that violate in most of `rescore_draws` flights, each with
        other noise, and in how many; those of the search if none does."""
        for values in reversed(self.violating):
            draws = range(self.number, self.number + self.test.rescore_draws)
            failed = sum(self.fly(values, number) for number in draws)
            if failed >= STEADY * len(draws):
                break
        return values, failed


def reduce_case(test: TestFile, case: Case, folder: Path) -> Counterexample:
    """Reduce a case, fly it `rescore_draws` times, and write it to a folder."""
    test, values = expand_picks(test, Evaluator(test).space.values_at(case.point))
    flights = _Flights(test, case.number, dict(values))
    values = drop_faults(test, values, flights.violate)
    for name, value in _simpler_values(test, values):
        changed = values | {name: value}
        values = changed if flights.violate(changed) else values
    shrink_faults(test, values, flights.violate)
    values, failed = flights.repeat()
    document = document_of(test, values, seed_of(test.seed, case.number))
    # An autopilot's flights differ: one that shows the violation is kept.
    for _ in range(test.rescore_draws):
        shutil.rmtree(folder / "with", ignore_errors=True)
        flights.count += 1
        flight = fly_point(test, document, folder / "with")
        (found,) = flight.requirements[test.estimator]
        if found.met is False:
            break
    calm = {**document, "schedule": {**document["schedule"], "faults": []}}
    fly_point(test, calm, folder / "without")
    write_curves(test, folder)
    return Counterexample(
        violation=f"{found.name}: {found.describe()}", faults=document["schedule"]["faults"],
        flown=test.rescore_draws, failed=failed, behaviour=flight.behaviour,
        flights=flights.count + 1, command=write_schedule(test, document, folder),
    )  # fmt: skip


def _simpler_values(test: TestFile, values: Values) -> Iterator[tuple[str, float]]:
    """Varied values of the scenario, such as the wind, and what they are without the search."""
    for name in test.vary:
        own: Any = test.scenario
        for part in name.replace("]", "").replace("[", ".").split("."):
            own = own[int(part)] if part.isdigit() else own[part]
        if isinstance(own, int | float) and values[f"vary.{name}"] != own:
            yield f"vary.{name}", float(own)


def write_schedule(test: TestFile, document: Mapping[str, Any], folder: Path) -> str:
    """Write scenario and schedule; return the command that flies them."""
    schedule = folder / "schedule.yaml"
    schedule.write_text(write_yaml(schedule_of(document)))
    words = ["mavproxy-fault", "run", write_scenario(document, folder)]
    words += ["--schedule", str(schedule)]
    return shlex.join(words + (test.autopilot.options() if test.autopilot else []))


def write_curves(test: TestFile, folder: Path) -> None:
    """Write `report.html` of the flight with the faults, with the curves of that without them."""
    logs = [next((folder / side).rglob(SENT)) for side in ("with", "without")]
    labels = read_labels(logs[0].parent / LABELS)
    thresholds = Thresholds(requirements=[msgspec.to_builtins(test.requirement)])
    flown = assess_flight(read_flight(logs[:1], labels), thresholds)
    write_report(folder, flown, [assess_flight(read_flight(logs[1:], ()), thresholds)])
