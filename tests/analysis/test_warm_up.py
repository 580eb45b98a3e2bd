"""`warm-up` plays what users call, its files are right, and only wheels change numba's settings."""

import argparse
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from analysis import warm_up
from analysis.search.space.test_file import read_test
from mavproxy_fault.numerics.baseline import BASELINE, runs_baseline
from simvehicle.scenario.scenario_file import read_scenario


def test_every_flight_and_search_is_a_right_file(tmp_path: Path) -> None:
    works = [work for chain in warm_up._chains(tmp_path) for _, work in chain]
    calls = [work for work in works if isinstance(work, partial)]
    lines = [work.args[0] for work in calls if work.func is warm_up._carry_out]
    for scenario in (work.args[0] for work in calls if work.func is warm_up._make_stretches):
        read_scenario(scenario)
    assert {words[0] for words in lines} == {"run", "monitor", "report", "search"}
    for words in lines:
        if words[0] == "run":
            read_scenario(words[-1])
        elif words[0] == "search":
            read_test(words[-1])


def test_a_command_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.yaml"):
        warm_up._carry_out(["run", "--out", str(tmp_path / "out"), str(tmp_path / "none.yaml")])


@pytest.mark.skipif(not runs_baseline(), reason="this processor is older than the baseline")
def test_portable_code_is_for_the_baseline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MAVPROXY_FAULT_CACHE", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"):
        monkeypatch.setenv(name, "")  # is restored
    warm_up._aim_at_baseline(str(tmp_path))
    assert os.environ["NUMBA_CPU_NAME"] == BASELINE
    assert os.environ["MAVPROXY_FAULT_CACHE"] == str(tmp_path)


def test_numba_is_not_loaded_before_the_baseline_is_set() -> None:
    script = "import sys, analysis.warm_up; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert done.stdout.split() == [b"False"]


def test_it_is_a_command() -> None:
    top = argparse.ArgumentParser()
    warm_up.add_warm_up(top.add_subparsers())
    assert top.parse_args(["warm-up"]).portable is None
