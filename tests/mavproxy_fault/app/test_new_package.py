"""`mavproxy-fault new` writes packages whose tests pass."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mavproxy_fault.cli import main


@pytest.mark.parametrize("kind", ["estimator", "detector", "fault"])
def test_the_test_of_a_new_package_passes(
    kind: str,
    tmp_path: Path,
    install_package: Callable[[Path], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "my-own"
    assert main(["new", kind, "my-own", "--out", str(folder)]) == 0
    assert str(folder / f"test_{'my_own'}.py") in capsys.readouterr().out.splitlines()
    install_package(folder)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True, text=True, check=False, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
    # Its style is that of the house.
    for words in (["check", "--select", "E,F,I,B,UP"], ["format", "--check"]):
        line = [sys.executable, "-m", "ruff", *words, "--no-cache", "--isolated"]
        subprocess.run([*line, "--line-length", "100", str(folder)], check=True)


@pytest.mark.parametrize(("name", "wrong"), [("My", "is no name"), ("here", "File exists")])
def test_a_name_that_cannot_be_used_is_refused(
    name: str, wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").mkdir()
    assert main(["new", "fault", name]) == 2
    assert wrong in capsys.readouterr().err
