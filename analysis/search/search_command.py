"""`search`: search for the worst case of an estimator until the budget is used up."""

import argparse
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np

from analysis.flying.worker_pool import WorkerPool, open_worker_pool
from analysis.report.run_folder import numbered_folder
from analysis.search.archive import Archive, Case
from analysis.search.cases import (
    Totals,
    WorstCase,
    log_text,
    noiseless_error,
    write_cases,
)
from analysis.search.counterexample import Counterexample, reduce_case
from analysis.search.evaluation.envelope import LIMITS
from analysis.search.evaluation.evaluation_job import evaluate_with
from analysis.search.evaluation.evaluator import EvaluationOutcome, Evaluator, seed_of
from analysis.search.history import RECORD, History
from analysis.search.searchers import make_searcher
from analysis.search.shrink import Values, drop_faults, mean_error, shrink_faults
from analysis.search.space.test_file import TestFile, read_test
from analysis.work_progress import WorkProgress
from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.arrays import Array

DEFAULT_BUDGET = 2000  # evaluations: half a minute of compiled flights
FRESH_SEED_OFFSET = 1_000_003  # added to the seed for noise that the search did not use
SIMULATOR_BATCH, AUTOPILOT_BATCH = (
    8,
    2,
)  # flights per checkpoint, in the simulator and with an autopilot
Progress = Callable[[int, float, int], None]


def main(args: argparse.Namespace) -> int:
    """Carry out the command."""
    test = apply_options(read_test(args.testfile), args)
    # Runs get their own numbered folder: nothing is overwritten.
    folder = Path(args.out) if args.out else numbered_folder("search")
    pool = open_worker_pool(args.workers, args.ray)
    try:
        with WorkProgress("searching", test.budget or DEFAULT_BUDGET, "tests") as bar:

            def show(tests: int, worst: float, budget: int) -> None:
                bar.show(tests, f"worst {worst:.4g} {test.unit}", budget)

            if test.violate is not None:
                return falsify(test, pool, folder, show, bar.say)
            cases, totals = run_search(test, pool, folder, show, bar.say)
    finally:
        pool.close()
    text = log_text(test, cases, totals)
    (folder / "TestResFile.log").write_text(text)
    write_cases(folder, test, cases)
    summary = {"totals": totals._asdict(), "cases": [c._asdict() for c in cases]}
    (folder / "search-summary.json").write_bytes(msgspec.json.format(msgspec.json.encode(summary)))
    print_result(args, {**summary, "folder": folder}, f"\n{text}\n{folder}/")
    return 0


def apply_options(test: TestFile, args: argparse.Namespace) -> TestFile:
    """The test with the command line's options."""
    changes = {
        name: getattr(args, name)
        for name in ("budget", "method", "seed", "violate", "first")
        if getattr(args, name, None) is not None
    }
    # `1` if not given: the test file has been checked already.
    if changes.get("budget", 1) <= 0:
        raise ConfigError(f"--budget: {changes['budget']} is not positive; give 1 or more")
    changed = msgspec.structs.replace(test, **changes)
    if changed.violate is not None:
        try:
            _ = changed.requirement
        except ValueError as error:
            raise ConfigError(f"--violate: {error}") from None
    return changed


def falsify(
    test: TestFile, pool: WorkerPool, folder: Path, progress: Progress, say: Callable[[str], None]
) -> int:
    """Search for flights that violate the requirement, and reduce them; return 1 if there are any.

    Each counterexample has a folder with its scenario, schedule and curves.
    """
    archive = Archive(test.keep)
    tests, _ = search_cases(test, pool, folder, archive, Counter(), progress)
    violating = [case for case in archive.cases if case.fitness > 0.0]
    found: dict[tuple[str, ...], Counterexample] = {}
    for case in violating:
        if len(found) == test.keep:
            break
        say(f"test {case.number}: violated by {case.fitness:.3g}; reducing it")
        place = folder / f"counterexample-{len(found) + 1:02}"
        shutil.rmtree(place, ignore_errors=True)  # of an interrupted search, or alike
        reduced = reduce_case(test, case, place)
        # One for each behaviour and kinds of faults, in place of many of the same.
        found.setdefault(reduced.likeness, reduced)
    print(f"{test.requirement.label}: {tests} flights, {len(violating)} of those kept violate it")
    for one in found.values():
        print(f"\n{one.describe()}")
    summary = {
        "requirement": test.requirement, "flights": tests, "counterexamples": [*found.values()]
    }  # fmt: skip
    (folder / "search-summary.json").write_bytes(msgspec.json.encode(summary))
    return int(bool(found))


def run_search(
    test: TestFile,
    pool: WorkerPool,
    folder: Path,
    progress: Progress | None = None,
    say: Callable[[str], object] | None = None,
) -> tuple[list[WorstCase], Totals]:
    """Search, score the candidates on fresh noise, shrink the faults of the worst.

    An interrupted search continues from its folder.
    """
    started = time.perf_counter()
    archive = Archive(test.keep)
    rejected: Counter[str] = Counter()
    tests, steps = search_cases(test, pool, folder, archive, rejected, progress)
    # This takes as long as many tests.
    say = say or str
    say(f"rescoring the worst {len(archive.cases)}, {test.rescore_draws} flights each")
    ranked = rescore_cases(test, pool, archive.cases, progress)[: test.keep]
    cases = []
    for rank, (case, outcome) in enumerate(ranked, 1):
        error = float(outcome.fitness[0])
        say(f"case {rank} of {len(ranked)}: {error:.4g} {test.unit}; shrinking its faults")
        cases.append(finish_case(test, case, outcome))
    totals = Totals(tests, dict(rejected), steps, time.perf_counter() - started, steps * test.dt_s)
    return cases, totals


def search_cases(
    test: TestFile,
    pool: WorkerPool,
    folder: Path,
    archive: Archive,
    rejected: Counter[str],
    progress: Progress | None,
) -> tuple[int, int]:
    """Search until the budget or time is used up; returns the numbers of tests and steps."""
    dimension = Evaluator(test).space.dimension
    # With a time limit only, the budget is out of reach.
    budget = test.budget or (DEFAULT_BUDGET if test.time_s is None else 10**9)
    # Nothing varies: one evaluation is enough.
    if dimension == 0:
        budget = 1
    method = make_searcher(test.method if dimension else "random", dimension, test.seed, budget)
    history = History(folder, {"test": msgspec.to_builtins(test)})
    deadline = time.monotonic() + (test.time_s if test.time_s is not None else np.inf)
    tests = steps = 0
    try:
        while tests < budget and time.monotonic() < deadline:
            if test.first and archive.cases and archive.cases[0].fitness > 0.0:
                break
            points = method.ask()
            requested = len(points)
            # The last batch may be larger than the rest of the budget.
            points = points[: budget - tests]
            parts = []
            for part in evaluate_points(test, pool, history, points, tests, deadline):
                parts.append(part)
                if progress is not None:
                    worst = max(float(one["fitness"].max()) for one in parts)
                    worst = max([worst, *(case.fitness for case in archive.cases)])
                    progress(tests + sum(map(len, parts)), worst, budget)
                if test.first and part["fitness"].max() > 0.0:
                    break
            records = np.concatenate(parts)
            points = points[: len(records)]
            archive.add(tests, points, records["fitness"])
            rejected.update(LIMITS[limit] for limit in records["broken_limit"] if limit > 0)
            tests += len(points)
            steps += int(records["steps"].sum())
            # An incomplete generation is not reported: methods expect all their points.
            if len(points) == requested:
                method.report(points, records["fitness"])
    finally:
        history.close()
    return tests, steps


def evaluate_points(
    test: TestFile, pool: WorkerPool, history: History, points: Array, first: int, deadline: float
) -> Iterator[np.ndarray[tuple[int], np.dtype[np.void]]]:
    """Records of points (n, d): from the history as far as it goes, else flown and appended.

    Flights in the simulator run in batches; only the first may start after the deadline.
    """
    # Flights in the simulator are slow: a checkpoint after each batch loses little.
    length = (
        AUTOPILOT_BATCH if test.autopilot else SIMULATOR_BATCH if test.simulated else len(points)
    )
    for start in range(0, len(points), length):
        # At least one batch, so that a search always has a result.
        if start and time.monotonic() > deadline:
            break
        part, number = points[start : start + length], first + start
        records = history.recall(len(part))
        if records is None:
            outcome = evaluate_with(pool, test, part, test.seed, number, test.noise_draws)
            records = records_of(outcome)
            history.append(records)
        yield records


def records_of(outcome: EvaluationOutcome) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """The history's records of a batch; its steps are in the first record."""
    records = np.zeros(len(outcome.fitness), RECORD)
    records["fitness"] = outcome.fitness
    records["broken_limit"] = outcome.broken_limit
    # Only the sum of steps is needed.
    records["steps"][0] = outcome.steps
    return records


def rescore_cases(
    test: TestFile, pool: WorkerPool, cases: list[Case], progress: Progress | None = None
) -> list[tuple[Case, EvaluationOutcome]]:
    """Candidates within the envelope with their error on fresh noise, worst first."""
    # A fitness of zero or less: the flight left the envelope.
    valid = [case for case in cases if case.fitness > 0.0]
    if not valid:
        return []
    # Fresh noise removes the selection bias of the best of many.
    seed, draws = test.seed + FRESH_SEED_OFFSET, test.rescore_draws
    worst = max(case.fitness for case in valid)
    rescored: list[tuple[Case, EvaluationOutcome]] = []
    for case in valid:
        outcome = evaluate_with(pool, test, case.point[None, :], seed, case.number, draws)
        rescored.append((case, outcome))
        if progress is not None:
            progress(len(rescored), worst, len(valid))
    return sorted(rescored, key=lambda pair: -pair[1].fitness[0])


def finish_case(test: TestFile, case: Case, outcome: EvaluationOutcome) -> WorstCase:
    """Complete a case: values by name, error without noise, smallest fault that still breaks."""
    values = Evaluator(test).space.values_at(case.point)
    error = float(outcome.fitness[0])
    # The first of its draws.
    number = case.number * test.rescore_draws
    worst = WorstCase(
        case.number,
        values,
        case.fitness,
        error,
        # The standard error of the mean.
        float(outcome.spread_deg[0] / np.sqrt(test.rescore_draws)),
        noiseless_error(test, values),
        tuple(outcome.rmse_deg[0].tolist()),
        seed_of(test.seed + FRESH_SEED_OFFSET, number),
        Evaluator(test).scores(values, test.seed + FRESH_SEED_OFFSET, number, in_parts=True).parts,
    )
    # Without a limit in the test file: half of the error still counts as broken.
    limit = test.breaks_at_deg if test.breaks_at_deg is not None else 0.5 * error
    if not test.faults or error < limit:
        return worst

    def breaks(case: Values) -> bool:
        return mean_error(test, case, test.seed + FRESH_SEED_OFFSET) >= limit

    least = shrink_faults(test, drop_faults(test, values, breaks), breaks)
    shrunk_deg = mean_error(test, least, test.seed + FRESH_SEED_OFFSET)
    return worst._replace(shrunk=least, shrunk_deg=shrunk_deg)
