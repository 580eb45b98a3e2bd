"""`search`: look for the worst case of an estimator until the budget is used up."""

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.search.archive import Archive, Case
from analysis.search.breakdown import case_breakdown
from analysis.search.cases import (
    Totals,
    WorstCase,
    log_text,
    noiseless_error,
    write_cases,
)
from analysis.search.evaluation.compiled_batch import EvaluationOutcome
from analysis.search.evaluation.evaluator import make_evaluator
from analysis.search.evaluation.pool import Pool, pool_of
from analysis.search.history import RECORD, History
from analysis.search.lanes import rows
from analysis.search.lanes.noise_kernel import seed_of
from analysis.search.search_progress import SearchProgress
from analysis.search.searchers import make_searcher
from analysis.search.shrink import MeanErrors, shrink_faults
from analysis.search.space.test_file import TestFile, read_test
from mavproxy_fault.documents.errors import ConfigError

DEFAULT_BUDGET = 2000
FRESH_SEED_OFFSET = 1_000_003  # added to the seed for noise that the search has not seen
SIMULATOR_BATCH, AUTOPILOT_BATCH = (
    8,
    2,
)  # flights in the simulator between two checkpoints, and under an autopilot
Array = NDArray[np.float64]
Progress = Callable[[int, float, int], None]


def main(args: argparse.Namespace) -> int:
    """Carry out the command."""
    test = apply_options(read_test(args.testfile), args)
    # Runs get their own folder, numbered: nothing is written over.
    folder = Path(args.out) if args.out else new_folder(Path("runs"))
    pool = pool_of(args.workers, args.ray)
    try:
        progress = SearchProgress(test.unit)
        cases, totals = run_search(test, pool, folder, progress, progress.print_line)
    finally:
        pool.close()
    text = log_text(test, cases, totals)
    (folder / "TestResFile.log").write_text(text)
    write_cases(folder, test, cases)
    (folder / "search-summary.json").write_bytes(
        msgspec.json.format(
            msgspec.json.encode({"totals": totals._asdict(), "cases": [c._asdict() for c in cases]})
        )
    )
    print(f"\n{text}\n{folder}/")
    return 0


def apply_options(test: TestFile, args: argparse.Namespace) -> TestFile:
    """The test with what the command line says otherwise."""
    changes = {
        name: getattr(args, name)
        for name in ("budget", "method", "seed")
        if getattr(args, name, None) is not None
    }
    # `1` where none was given: the test file has been checked already.
    if changes.get("budget", 1) <= 0:
        raise ConfigError(f"--budget: {changes['budget']} is not positive; evaluations, 1 or more")
    return msgspec.structs.replace(test, **changes)


def new_folder(parent: Path) -> Path:
    """`search-1` or the first number that is free."""
    number = 1
    while (parent / f"search-{number}").exists():
        number += 1
    return parent / f"search-{number}"


def run_search(
    test: TestFile,
    pool: Pool,
    folder: Path,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[list[WorstCase], Totals]:
    """Search, score the candidates on fresh noise, shrink the faults of the worst.

    A search that was killed goes on from its folder.
    """
    started = time.perf_counter()
    archive = Archive(test.keep)
    rejected: Counter[str] = Counter()
    tests, steps = search_cases(test, pool, folder, archive, rejected, progress)
    # In the simulator and under an autopilot this takes as long as many tests.
    say = say if say is not None and test.simulated else _silent
    say(f"the worst {len(archive.cases)} on fresh noise, {test.rescore_draws} flights each")
    ranked = rescore_cases(test, pool, archive.cases)[: test.keep]
    cases = []
    for rank, (case, outcome) in enumerate(ranked, 1):
        error = float(outcome.fitness[0])
        say(f"number {rank} of {len(ranked)}: {error:.4g} {test.unit}; making it smaller")
        cases.append(finish_case(test, case, outcome))
    totals = Totals(tests, dict(rejected), steps, time.perf_counter() - started, steps * test.dt_s)
    return cases, totals


def _silent(text: str) -> None:
    """Nobody listens."""


def search_cases(
    test: TestFile,
    pool: Pool,
    folder: Path,
    archive: Archive,
    rejected: Counter[str],
    progress: Progress | None,
) -> tuple[int, int]:
    """Ask, fly and tell until the budget or the time is used up; tests and steps made."""
    dimension = make_evaluator(test).space.dimension
    # With a limit of time alone the budget is out of reach.
    budget = test.budget or (DEFAULT_BUDGET if test.time_s is None else 10**9)
    # Nothing varies: one evaluation says it all.
    if dimension == 0:
        budget = 1
    method = make_searcher(test.method if dimension else "random", dimension, test.seed, budget)
    history = History(folder, {"test": msgspec.to_builtins(test)})
    deadline = time.monotonic() + (test.time_s if test.time_s is not None else np.inf)
    tests = steps = 0
    try:
        while tests < budget and time.monotonic() < deadline:
            points = method.ask()
            asked = len(points)
            # The last batch may be larger than what is left of the budget.
            points = points[: budget - tests]
            parts = []
            for part in evaluate_points(test, pool, history, points, tests, deadline):
                parts.append(part)
                if progress is not None:
                    worst = max(float(one["fitness"].max()) for one in parts)
                    worst = max([worst, *(case.fitness for case in archive.cases)])
                    progress(tests + sum(map(len, parts)), worst, budget)
            records = np.concatenate(parts)
            points = points[: len(records)]
            archive.add(tests, points, records["fitness"])
            rejected.update(rows.LIMITS[limit] for limit in records["broken_limit"] if limit > 0)
            tests += len(points)
            steps += int(records["steps"].sum())
            # A generation that was cut short teaches nothing: the methods expect what they asked
            # for.
            if len(points) == asked:
                method.tell(points, records["fitness"])
    finally:
        history.close()
    return tests, steps


def evaluate_points(
    test: TestFile, pool: Pool, history: History, points: Array, first: int, deadline: float
) -> Iterator[np.ndarray[tuple[int], np.dtype[np.void]]]:
    """What became of points (n, d), from the history as far as it goes, else flown and written.

    Flights in the simulator go in portions; none begins after the deadline but the first.
    """
    # Flights in the simulator are slow: a checkpoint after each portion loses little to a kill.
    length = (
        AUTOPILOT_BATCH if test.autopilot else SIMULATOR_BATCH if test.simulated else len(points)
    )
    for start in range(0, len(points), length):
        # At least one portion, so that a search always has an answer.
        if start and time.monotonic() > deadline:
            break
        part, number = points[start : start + length], first + start
        records = history.recall(len(part))
        if records is None:
            outcome = pool.evaluate(test, part, test.seed, number, test.noise_draws)
            records = records_of(outcome)
            history.append(records)
        yield records


def records_of(outcome: EvaluationOutcome) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """What the history keeps of a batch; the batch's steps stand with its first record."""
    records = np.zeros(len(outcome.fitness), RECORD)
    records["fitness"] = outcome.fitness
    records["broken_limit"] = outcome.broken_limit
    # The history holds a record for each point, and only the sum of steps is asked for.
    records["steps"][0] = outcome.steps
    return records


def rescore_cases(
    test: TestFile, pool: Pool, cases: list[Case]
) -> list[tuple[Case, EvaluationOutcome]]:
    """Candidates that stayed within the envelope by their error on fresh noise, worst first."""
    # A fitness of zero or less: the flight left the envelope.
    stayed = [case for case in cases if case.fitness > 0.0]
    if not stayed:
        return []
    # Fresh noise: the best of many is partly luck, which a second look takes away.
    seed, draws = test.seed + FRESH_SEED_OFFSET, test.rescore_draws
    found = [
        (case, pool.evaluate(test, case.point[None, :], seed, case.number, draws))
        for case in stayed
    ]
    return sorted(found, key=lambda pair: -pair[1].fitness[0])


def finish_case(test: TestFile, case: Case, outcome: EvaluationOutcome) -> WorstCase:
    """Values by name, the error without noise, and the smallest fault that still breaks."""
    values = {
        k: float(v[0]) for k, v in make_evaluator(test).space.values(case.point[None, :]).items()
    }
    error = float(outcome.fitness[0])
    # The first of its draws: `case_breakdown` flies that very one.
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
        case_breakdown(test, values, test.seed + FRESH_SEED_OFFSET, number),
    )
    # Without a limit of its own: half of the error still counts as broken.
    limit = test.breaks_at_deg if test.breaks_at_deg is not None else 0.5 * error
    if not test.faults or error < limit:
        return worst
    errors = MeanErrors(test, test.seed + FRESH_SEED_OFFSET, test.noise_draws)
    least = shrink_faults(test, values, limit, errors)
    return worst._replace(shrunk=least, shrunk_deg=float(errors([least])[0]))
