"""Machine code that came with the installation serves; what is lacking is made once."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mavproxy_fault.numerics import code_cache
from mavproxy_fault.numerics.baseline import BASELINE, runs_baseline
from mavproxy_fault.numerics.compile import compiled

SCRIPT = """
import sys
from pathlib import Path
from mavproxy_fault.numerics import code_cache
code_cache.installed = lambda: Path(sys.argv[1])
from mavproxy_fault.numerics.compile import compiled

@compiled
def twice(x):
    return 2.0 * x

assert twice(3.0) == 6.0
if sys.argv[2:]:

    @compiled
    def squared(x):
        return twice(x) * twice(x)

    assert squared(3.0) == 36.0
stats = twice.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def python(tmp_path: Path, installed: Path, *words: str, **environment: str) -> list[str]:
    """What the script prints: functions that were loaded, and that were compiled."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script), str(installed), *words],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return [*done.stdout.split(), *done.stderr.splitlines()]


@pytest.mark.skipif(not runs_baseline(), reason="this processor is older than the baseline")
def test_code_for_the_baseline_serves_every_later_processor(tmp_path: Path) -> None:
    built, own = tmp_path / "built", tmp_path / "own"
    aim = {"NUMBA_CPU_NAME": BASELINE, "NUMBA_CPU_FEATURES": ""}
    loaded, made, *lines = python(tmp_path, tmp_path, MAVPROXY_FAULT_CACHE=str(built), **aim)
    assert (loaded, made) == ("0", "1")
    assert ["compiling kernels (first use only): 0 done, 0 s" in line for line in lines] == [True]
    assert python(tmp_path, built, MAVPROXY_FAULT_CACHE=str(own)) == ["1", "0"]
    assert not any(own.rglob("*.nbc"))


def test_code_that_another_process_removes_meanwhile_is_not_a_folder_without_access(
    tmp_path: Path,
) -> None:
    gone = tmp_path / "code" / "kernels" / "old-version" / "function.nbc"
    gone.parent.mkdir(parents=True)
    gone.symlink_to(tmp_path / "removed")
    lines = python(tmp_path, tmp_path, MAVPROXY_FAULT_CACHE=str(tmp_path / "code"))[2:]
    assert ["compiling kernels (first use only): 0 done, 0 s" in line for line in lines] == [True]


def test_code_from_the_disk_is_inlined_by_what_is_compiled_later(tmp_path: Path) -> None:
    code = {"MAVPROXY_FAULT_CACHE": str(tmp_path / "code")}
    python(tmp_path, tmp_path, **code)
    assert python(tmp_path, tmp_path, "further", **code)[:2] == ["1", "0"]


def test_where_nothing_can_be_written_functions_still_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(code_cache, "place", lambda: tmp_path / "file")
    with caplog.at_level(logging.CRITICAL):

        @compiled
        def thrice(x: float) -> float:
            return 3.0 * x

        assert thrice(2.0) == 6.0


def test_one_process_at_a_time_makes_a_function(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    lock = tmp_path / "new" / "function.lock"
    with code_cache.alone(lock), lock.open() as theirs, pytest.raises(BlockingIOError):
        fcntl.flock(theirs, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with lock.open() as theirs:
        fcntl.flock(theirs, fcntl.LOCK_EX | fcntl.LOCK_NB)
