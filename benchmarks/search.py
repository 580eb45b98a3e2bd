"""Speed and quality of the worst-case search; prints tables for search.md.

python benchmarks/search.py speed
python benchmarks/search.py workers
python benchmarks/search.py start
python benchmarks/search.py quality [SEEDS [ESTIMATOR ...]]
python benchmarks/search.py harder [SEEDS]
"""

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np

HERE = Path(__file__).parent
BUDGET = 2000
STEADY = {
    "initial": {"u_mps": [33, 37], "v_mps": [-1, 1], "roll_deg": [-10, 10], "p_dps": [-5, 5]},
    "duration_s": 60.0,
}
FAULTS = [
    {
        "fault": "bias",
        "any_of": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"],
        "value": [-0.02, 0.02],
        "at_s": [1, 6],
        "for_s": [0.5, 4],
    },
]
SPACE = {
    "duration_s": 8.0,
    "noise_draws": 2,
    "initial": {
        "height_m": 3000,
        "u_mps": [25, 45],
        "v_mps": [-3, 3],
        "w_mps": [-3, 3],
        "roll_deg": [-60, 60],
        "pitch_deg": [-20, 20],
        "p_dps": [-60, 60],
        "q_dps": [-60, 60],
        "r_dps": [-60, 60],
    },
    "controls": {
        "elevator_deg": [-6, 1],
        "aileron_deg": [-2, 2],
        "rudder_deg": [-2, 2],
        "throttle": [0, 1],
    },
    "faults": FAULTS,
}


HARDER = {
    **SPACE,
    "duration_s": 15.0,
    "faults": [
        {**FAULTS[0], "at_s": [1, 12]},
        {
            "fault": "bias",
            "any_of": ["HIL_SENSOR.xacc", "HIL_SENSOR.yacc", "HIL_SENSOR.zacc"],
            "value": [-1, 1],
            "at_s": [1, 12],
            "for_s": [0.5, 4],
        },
    ],
}


def batch_of(**changes):
    from analysis.search.evaluation.evaluator import Evaluator
    from analysis.search.space.test_file import TestFile

    return Evaluator(msgspec.convert(changes, TestFile))


def cpu(function):
    started = time.process_time()
    result = function()
    return result, time.process_time() - started


def ours(estimator="inverse-model", count=256):
    batch = batch_of(**STEADY, estimator=estimator, noise_draws=1)
    points = np.random.default_rng(1).random((count, batch.space.dimension))
    batch.evaluate(points[:2], 1, 0)
    outcome, seconds = cpu(lambda: batch.evaluate(points, 1, 0))
    assert (outcome.broken_limit == 0).all()
    return outcome.steps / seconds


def jsbsim():
    import jsbsim as package

    plane = package.FGFDMExec(None)
    plane.set_debug_level(0)
    plane.load_model("c172p")
    plane.set_dt(0.01)
    plane["ic/h-sl-ft"], plane["ic/vc-kts"] = 3000, 100
    plane.run_ic()
    steps = 20_000
    _, seconds = cpu(lambda: [plane.run() for _ in range(steps)])
    return steps / seconds


def scilab():
    if shutil.which("scilab-cli") is None:
        return None
    command = ["scilab-cli", "-nb", "-f", str(HERE / "search.sce"), "-quit"]
    text = subprocess.run(command, capture_output=True, text=True, timeout=300).stdout
    tests, seconds = re.search(r"RESULT (\d+) ([\d.]+)", text).groups()
    return int(tests) * 6000 / float(seconds)


def speed():
    """Every program three times in turn, so that a busy machine is busy for all; medians."""
    programs = {
        "Scilab, ode() + sensors + Heun": scilab,
        "JSBSim c172p, no sensors, no estimator": jsbsim,
        "ours, inverse sensor model": lambda: ours(count=32),
        "ours, Mahony": lambda: ours("mahony", 32),
        "ours, EKF": lambda: ours("ekf", 32),
    }
    found = {name: [] for name in programs}
    for _ in range(3):
        for name, program in programs.items():
            found[name].append(program())
    base = found["Scilab, ode() + sensors + Heun"]
    print("| program | million steps per CPU-s | tests of 60 s per CPU-minute | x Scilab |")
    print("|---|---|---|---|")
    for name, rates in found.items():
        if None in rates:
            print(f"| {name} | not installed | | |")
            continue
        ratio = ""
        if None not in base:
            ratio = f"{np.median(np.divide(rates, base)):.0f}"
        rate = np.median(rates)
        print(f"| {name} | {rate / 1e6:.4g} | {rate / 100:.0f} | {ratio} |")


def workers():
    """Tests of 60 s a minute of wall time on two processes, noise drawn for each flight."""
    from analysis.flying.worker_pool import LocalWorkerPool
    from analysis.search.evaluation.evaluation_job import evaluate_with
    from analysis.search.space.test_file import TestFile

    test = msgspec.convert({**STEADY, "noise_draws": 1}, TestFile)
    points = np.random.default_rng(1).random((512, 4))
    pool = LocalWorkerPool(2)
    evaluate_with(pool, test, points[:64], 1, 0, 1)
    for _ in range(3):
        started = time.perf_counter()
        evaluate_with(pool, test, points, 1, 0, 1)
        seconds = time.perf_counter() - started
        print(f"{len(points) / seconds * 60:.0f} tests a minute on two processes")
    pool.close()


def start():
    """Seconds until the first flight is done, in a new process; run twice."""
    code = (
        "import time; t = time.perf_counter()\n"
        "import sys; sys.path.insert(0, 'benchmarks'); import search\n"
        "b = search.batch_of(**search.STEADY); b.space; t1 = time.perf_counter()\n"
        "b.evaluate(__import__('numpy').zeros((1, b.space.dimension)), 1, 0, 1)\n"
        "print(f'imports {t1 - t:.2f} s, kernel {time.perf_counter() - t1:.2f} s')"
    )
    for _ in range(2):
        subprocess.run([sys.executable, "-c", code], check=True, cwd=HERE.parent)


def one_search(batch, method, seed):
    """Best fitness after each evaluation, and the winner's on fresh noise."""
    from analysis.search.archive import Archive
    from analysis.search.searchers import make_searcher

    made = make_searcher(method, batch.space.dimension, seed, BUDGET)
    archive, best, tests = Archive(1), [], 0
    while tests < BUDGET:
        points = made.ask()[: BUDGET - tests]
        outcome = batch.evaluate(points, seed, tests)
        if tests + len(points) < BUDGET:
            made.report(points, outcome.fitness)
        archive.add(tests, points, outcome.fitness)
        best.append(outcome.fitness)
        tests += len(points)
    fresh = [
        batch.evaluate(c.point[None, :], seed + 10_000, 0, 100).fitness[0] for c in archive.cases
    ]
    return np.maximum.accumulate(np.concatenate(best)), max(fresh)


def quality(seeds, estimators, space=SPACE, methods=("random", "mixed")):
    print(
        "| estimator | method | median worst, seen | on 100 fresh seeds | x random | "
        "evaluations to random's median |\n|---|---|---|---|---|---|"
    )
    for estimator in estimators:
        batch = batch_of(**space, estimator=estimator)
        goal = base = None
        for method in methods:
            runs = [one_search(batch, method, seed) for seed in range(seeds)]
            curves = np.array([run[0] for run in runs])
            fresh = float(np.median([run[1] for run in runs]))
            if goal is None:
                goal, base = float(np.median(curves[:, -1])), fresh
            reached = np.where(
                curves[:, -1] >= goal, 1 + np.argmax(curves >= goal, axis=1), BUDGET + 1
            )
            count = np.median(reached)
            print(
                f"| {estimator} | {method} | {np.median(curves[:, -1]):.3f} | {fresh:.3f} | "
                f"{fresh / base:.2f} | {count:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "speed"
    if what in ("quality", "harder"):
        seeds = int(sys.argv[2]) if len(sys.argv) > 2 else 10
        if what == "harder":
            quality(seeds, ["mahony"], HARDER, ("random", "matyas", "cmaes", "mixed"))
        else:
            quality(seeds, sys.argv[3:] or ["inverse-model", "mahony"])
    else:
        {"speed": speed, "start": start, "workers": workers}[what]()
