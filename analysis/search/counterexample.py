"""Reduce a flight that violates a requirement to the simplest one that still does, and write it.

Delta debugging [1]_: faults are dropped, varied values of the scenario set back, then durations and
magnitudes reduced, as long as the flight violates the requirement. The result is flown again.

References
----------
.. [1] Zeller and Hildebrandt, IEEE Transactions on Software Engineering 28(2), 2002.
"""

import csv
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.judging.flight_signals import collect_signals
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.results import read_results
from analysis.scoring.requirements import TRUE, FlightSignals
from analysis.search.archive import Case
from analysis.search.evaluation.simulated_batch import SimulatedBatch
from analysis.search.evaluation.violation import fly_violation
from analysis.search.lanes.noise_kernel import seed_of
from analysis.search.shrink import fault_names, scale_toward_none
from analysis.search.space.fault_picks import expand_picks
from analysis.search.space.point_scenario import document_of
from analysis.search.space.test_file import TestFile
from mavproxy_fault.app.recorder import LABELS, SENT
from mavproxy_fault.documents.extras import has_extra
from mavproxy_fault.documents.yaml_document import without_none, write_yaml
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_columns

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
    write_curves(test, folder, document["start"]["alt_m"])
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


def write_curves(test: TestFile, folder: Path, ground_m: float) -> None:
    """Write `curves.csv`, and `curves.png` with matplotlib: the requirement's signals with and
    without the faults."""
    flown = {name: _signals(test, folder / name, ground_m) for name in ("with", "without")}
    names = sorted(name for name in test.requirement.signals if name in flown["with"].values)
    with (folder / "curves.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["faults", "t_s", *names])
        for side, signals in flown.items():
            columns = [signals.t_s, *(_shown(signals.values[name]) for name in names)]
            writer.writerows([side, *map(float, row)] for row in np.round(np.array(columns).T, 3))
    if not names or not has_extra("matplotlib"):
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 2.6 * len(names)), layout="constrained")
    for axes, name in zip(np.ravel([figure.subplots(len(names))]), names, strict=True):
        for side, signals in flown.items():
            axes.plot(signals.t_s, _shown(signals.values[name]), label=f"{side} the faults")
        axes.set(ylabel=name, xlabel="s")
        axes.legend()
    figure.savefig(folder / "curves.png", dpi=110)


def _signals(test: TestFile, folder: Path, ground_m: float) -> FlightSignals:
    log = next(folder.rglob(SENT))
    labels = read_labels(log.parent / LABELS)
    t0_us = labels[0].t0_us if labels else None
    recording = add_derived_curves(recording_of_tlog(read_columns(log), t0_us=t0_us))
    results = read_results(log.parent / "results.jsonl")
    signals = collect_signals(recording, labels, results, ground_m, test.estimator)
    assert signals is not None
    return signals


def _shown(values: Any) -> Any:
    """True and false as 1 and 0."""
    return np.where(np.abs(values) == TRUE, values > 0.0, values)
