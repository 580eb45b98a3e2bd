"""Campaigns: same seed same cases whatever the workers, resumed after a kill, written to files."""

import argparse

import numpy as np
import pytest

from analysis.flying.worker_pool import LocalWorkerPool, WorkerPool
from analysis.search.archive import MIN_DISTANCE, Archive, rms_distance
from analysis.search.cases import yaml_of_test
from analysis.search.evaluation.evaluator import EvaluationOutcome
from analysis.search.history import RECORD
from analysis.search.search_command import main, run_search
from analysis.search.space.test_file import (
    FaultRange,
    InitialState,
    Mission,
    SearchControls,
    TestFile,
    read_test,
)
from mavproxy_fault.documents.errors import ConfigError

TEST = TestFile(
    duration_s=1.5,
    rescore_draws=2,
    keep=1,
    budget=88,
    initial=InitialState(roll_deg=(-60.0, 60.0), pitch_deg=(-30.0, 30.0)),
    controls=SearchControls(elevator_deg=(-20.0, 1.0)),
    faults=[
        FaultRange(
            fault="bias",
            any_of=["HIL_SENSOR.xgyro", "HIL_SENSOR.zgyro"],
            value=(-0.02, 0.02),
            at_s=(0.1, 0.7),
            for_s=(0.2, 1.0),
        )
    ],
)


class Killed(Exception):
    """Stands for a kill."""


def test_the_worst_case_has_a_large_fault_and_a_smaller_one_that_still_breaks(tmp_path):
    cases, totals = run_search(TEST, WorkerPool(), tmp_path)
    worst = cases[0]
    assert totals.tests == 88
    assert sum(totals.rejected.values()) > 0
    assert abs(worst.values["faults[0].value"]) > 0.015
    assert worst.error_deg == max(case.error_deg for case in cases)
    size = abs(worst.shrunk["faults[0].value"]) * worst.shrunk["faults[0].for_s"]
    before = abs(worst.values["faults[0].value"]) * worst.values["faults[0].for_s"]
    assert 0.0 < size < before
    assert worst.shrunk_deg >= 0.5 * worst.error_deg
    assert worst.quiet_deg == pytest.approx(worst.error_deg, rel=0.2)


def test_workers_change_nothing(tmp_path):
    alone = run_search(TEST, WorkerPool(), tmp_path / "a")[0]
    pool = LocalWorkerPool(2)
    try:
        together = run_search(TEST, pool, tmp_path / "b")[0]
    finally:
        pool.close()
    assert alone == together
    assert (tmp_path / "a/history.bin").read_bytes() == (tmp_path / "b/history.bin").read_bytes()


def test_the_reported_worst_error_never_decreases(tmp_path):
    worst_errors = []
    run_search(
        TEST,
        WorkerPool(),
        tmp_path / "s",
        progress=lambda tests, worst, budget: worst_errors.append(worst),
    )
    assert worst_errors == sorted(worst_errors)


def test_a_killed_search_continues_where_it_was(tmp_path):
    whole = run_search(TEST, WorkerPool(), tmp_path / "whole")[0]

    def kill(tests, worst, budget):
        if tests >= 80:
            raise Killed

    with pytest.raises(Killed):
        run_search(TEST, WorkerPool(), tmp_path / "killed", progress=kill)
    history = tmp_path / "killed/history.bin"
    found = len(history.read_bytes())
    history.write_bytes(history.read_bytes()[:-5])  # the kill came within a record
    flown = []

    class Counting(WorkerPool):
        def start(self, number, job):
            if job.seed == TEST.seed:
                flown.append(job.first)
            super().start(number, job)

    resumed = run_search(TEST, Counting(), tmp_path / "killed")[0]
    assert resumed == whole
    assert min(flown) >= found // 16 - 40  # one batch again at most


def test_flights_in_the_simulator_are_saved_in_small_batches(tmp_path):
    test = TestFile(
        estimator="fusion", method="random", budget=40, initial=InitialState(roll_deg=(-9.0, 9.0))
    )

    class Dying(WorkerPool):
        def start(self, number, job):
            self.number, self.job = number, job

        def finished(self):
            if self.job.first == 16:
                raise Killed
            nothing = np.zeros(len(self.job.points))
            axes = np.zeros((len(nothing), 4))
            whole = nothing.astype(np.int64)
            return self.number, EvaluationOutcome(nothing, nothing, axes, axes, whole, 0)

    with pytest.raises(Killed):
        run_search(test, Dying(), tmp_path)
    assert len((tmp_path / "history.bin").read_bytes()) == 16 * RECORD.itemsize


def test_another_test_is_refused_in_the_same_folder(tmp_path):
    run_search(TestFile(duration_s=1.0, mission=Mission()), WorkerPool(), tmp_path)
    with pytest.raises(ConfigError, match="another search"):
        run_search(TEST, WorkerPool(), tmp_path)


def test_the_command_writes_log_and_files_that_fly_the_cases_again(tmp_path, capsys):
    path = tmp_path / "test.yaml"
    path.write_text(yaml_of_test(TEST))
    out = tmp_path / "out"
    arguments = argparse.Namespace(
        testfile=str(path), budget=80, method="random", seed=2, workers=None, ray=None,
        out=str(out),
    )  # fmt: skip
    assert main(arguments) == 0
    text = (out / "TestResFile.log").read_text()
    assert text in capsys.readouterr().out
    for said in (
        "Number of tests           80",
        "Greatest error",
        "Initial position",
        "Run time",
    ):
        assert said in text
    # The log is read by people: neither what is zero nor sensors as every search has them.
    assert "wind" not in text
    assert "sensors." not in text
    case = read_test(out / "worst-01-test.yaml")
    again, totals = run_search(case, WorkerPool(), tmp_path / "again")
    assert totals.tests == 1
    first = next(line for line in text.splitlines() if line.startswith("     1 "))
    assert again[0].error_deg == pytest.approx(float(first.split()[2]), rel=0.05)


def test_the_archive_keeps_cases_apart():
    archive = Archive(4)
    rng = np.random.default_rng(1)
    for first in range(0, 2000, 100):
        points = rng.random((100, 3))
        archive.add(first, points, -((points - 0.5) ** 2).sum(axis=1))
    found = archive.cases
    assert all(
        rms_distance(a.point, b.point) >= MIN_DISTANCE
        for i, a in enumerate(found)
        for b in found[:i]
    )
    assert [case.fitness for case in found] == sorted((c.fitness for c in found), reverse=True)


def test_a_test_file_that_is_written_reads_back_the_same(tmp_path):
    test = TestFile(mission=Mission(), initial=InitialState(roll_deg=3.0), seed=9)
    path = tmp_path / "t.yaml"
    path.write_text(yaml_of_test(test))
    assert read_test(path) == test


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("initial: {rol_deg: 3}", "initial.rol_deg is unknown; did you mean roll_deg"),
        ("initial: {roll_deg: [30, -30]}", "roll_deg = .* ends reversed"),
        (
            "faults: [{fault: melt, target: HIL_SENSOR.xgyro}]",
            "'melt' is not compiled; known: bias",
        ),
        (
            "faults: [{fault: bias, value: 1, target: HIL_SENSOR.xgyr}]",
            "unknown; known: HIL_SENSOR.xgyro",
        ),
        ("faults: [{fault: bias, target: HIL_SENSOR.xgyro}]", "faults.value is missing"),
        ("estimator: autopilot", "needs the section autopilot"),
        ("vary: {seed: [1, 2]}", "vary is set without scenario"),
        ("{criterion: state, estimator: ekf}", "ekf estimates fewer"),
        ("duration_s: 0", "duration_s = 0.* is not positive"),
        ("- 1", "is not a search; give keys: "),
    ],
)
def test_errors_of_a_test_file_name_the_line(tmp_path, text, said):
    path = tmp_path / "t.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_test(path)
