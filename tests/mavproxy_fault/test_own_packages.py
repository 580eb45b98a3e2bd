"""The command in folders whose files have the names of our packages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MODULE = [sys.executable, "-m", "mavproxy_fault.cli"]
SCRIPT = [str(Path(sys.executable).with_name("mavproxy-fault"))]
TEXT = "raise SystemExit('the file of the user was imported')\n"


def put_file(folder: Path, form: str, name: str) -> None:
    file = folder / (f"{name}.py" if form == "file" else f"{name}/__init__.py")
    if form == "namespace":
        file = folder / name / "notes.txt"
    file.parent.mkdir(exist_ok=True)
    file.write_text(TEXT)


@pytest.mark.parametrize("forms", [("file", "package"), ("namespace", "file")], ids="-".join)
@pytest.mark.parametrize("command", [MODULE, SCRIPT], ids=["module", "script"])
def test_files_with_the_names_of_our_packages_break_nothing(
    tmp_path: Path, forms: tuple[str, str], command: list[str]
) -> None:
    for form, name in zip(forms, ("analysis", "simvehicle"), strict=True):
        put_file(tmp_path, form, name)
    (tmp_path / "small.yaml").write_text("{duration_s: 2, start: {height_m: 50}}")
    # It reads a scenario and needs both packages, but does not fly.
    (tmp_path / "campaign.yaml").write_text(
        "{subjects: [ekf], scenarios: [small.yaml], faults: [{preset: gps-freeze}]}"
    )
    arguments = ["campaign", "campaign.yaml", "--dry-run"]
    done = subprocess.run(
        [*command, *arguments],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": "."},  # the folder comes first, in both forms
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.startswith("campaign: 1 cells"), done.stderr


def test_a_script_flies_beside_its_own_analysis(tmp_path: Path) -> None:
    put_file(tmp_path, "package", "simvehicle")
    # Imported by the script itself, as its own it may be.
    (tmp_path / "analysis.py").write_text("LIMIT = 3\n")
    (tmp_path / "script.py").write_text(
        "import analysis, mavproxy_fault\n"
        "run = mavproxy_fault.run({'duration_s': 2, 'start': {'height_m': 50}}, out='out')\n"
        "print(analysis.LIMIT, run.verdict)\n"
    )
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith("3 "), done.stderr


def test_ours_beside_another_that_is_loaded_is_refused_in_plain_words(tmp_path: Path) -> None:
    (tmp_path / "analysis.py").write_text("")
    (tmp_path / "script.py").write_text(
        "import analysis, sys\nfrom mavproxy_fault import cli\nsys.exit(cli.main(['run']))\n"
    )
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "analysis: another package of this name has been imported" in done.stderr
