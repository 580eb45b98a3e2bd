"""The steps of the GitHub Action, run as its runner would run them."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from mavproxy_fault import cli
from mavproxy_fault.cli import build_parser

ROOT = Path(__file__).parents[1]
ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text())
CAMPAIGN = ROOT / "tests" / "analysis" / "campaign" / "small.yaml"


def fly(tmp_path: Path, *, pythonpath: str = "", **inputs: str) -> subprocess.CompletedProcess[str]:
    """The step that flies, with our own installation in the place of the one before it."""
    environment = tmp_path / "mavproxy-fault" / "bin"
    environment.mkdir(parents=True)
    command = environment / "mavproxy-fault"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m mavproxy_fault.cli "$@"\n')
    command.chmod(0o755)
    step = next(step for step in ACTION["runs"]["steps"] if step["name"] == "Fly")
    given = {name: inputs.get(name.lower(), "") for name in step["env"]}
    for name, value in step["env"].items():
        assert value == f"${{{{ inputs.{name.lower()} }}}}"
    runner = {"RUNNER_TEMP": str(tmp_path), "GITHUB_STEP_SUMMARY": str(tmp_path / "summary")}
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        env={
            **os.environ,
            **given,
            **runner,
            "OUT": str(tmp_path / "out"),
            "PYTHONPATH": pythonpath,
        },
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a step that flew the campaign: red without any option, as the larger magnitude
    misleads both estimators."""
    folder = tmp_path_factory.mktemp("first")
    done = fly(folder, campaign=str(CAMPAIGN))
    assert done.returncode == 1, done.stderr
    return folder


def test_a_campaign_leaves_its_table_in_the_step_summary(first: Path) -> None:
    assert "| ekf | gyro | 0.001 rad/s unaffected | 2 rad/s " in (first / "summary").read_text()
    for name in ("campaign.html", "junit.xml", "cells.csv"):
        assert (first / "out" / name).is_file()


def test_against_a_baseline_only_what_got_worse_fails_the_step(first: Path, tmp_path: Path) -> None:
    (baseline := tmp_path / "baseline").mkdir()
    shutil.copy(first / "out" / "baseline.json", baseline)
    assert (baseline / "baseline.json").stat().st_size < 1000  # of four cells
    (again := tmp_path / "again").mkdir()
    shutil.copytree(first / "out", again / "out")
    assert (
        fly(again, campaign=str(CAMPAIGN), against=str(baseline / "baseline.json")).returncode == 0
    )
    # An aborted cell shows nothing, so it cannot pass.
    lines = (again / "out" / "cells.jsonl").read_text()
    assert '"outcome":"unaffected"' in lines
    (done := tmp_path / "done").mkdir()
    (done / "cells.jsonl").write_text(lines.replace('"unaffected"', '"aborted"'))
    shutil.copy(first / "out" / "campaign.json", done)
    assert cli.main(["campaign", "compare", str(baseline / "baseline.json"), str(done)]) == 1


def test_a_planted_regression_turns_the_copied_job_red(
    tmp_path: Path, install_package: Callable[[Path], None]
) -> None:
    cli.main(["new", "estimator", "my-own", "--out", str(tmp_path / "my-own")])
    install_package(tmp_path / "my-own")
    file, scenario = (tmp_path / "my-own" / name for name in ("my_own.py", "scenario.yaml"))
    campaign = yaml.safe_load((ROOT / "examples" / "ci" / "campaign.yaml").read_text())
    campaign |= {"subjects": ["my-own"], "scenarios": [str(scenario)], "onsets": [4], "seeds": [1]}
    # Two flights of 8 s instead of eighteen of 40.
    campaign |= {"durations_s": [3], "faults": [{**campaign["faults"][0], "magnitudes": [0.01]}]}
    scenario.write_text(scenario.read_text().replace("duration_s: 20", "duration_s: 8"))
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "campaign.yaml").write_text(yaml.safe_dump(campaign))
    (job,) = yaml.safe_load((ROOT / "examples/ci/github.yml").read_text())["jobs"].values()
    options = job["steps"][-1]["with"]
    for line, code in (("* 1e-6", 0), ("* 1e-5", 1)):  # a wrong unit
        text = file.read_text()
        assert "* 1e-6" in text
        file.write_text(text.replace("* 1e-6", line))
        folder = tmp_path / str(code)
        folder.mkdir()
        (folder / "tests").symlink_to(tmp_path / "tests")
        done = fly(folder, **options, pythonpath=str(tmp_path / "my-own"))
        assert done.returncode == code, done.stdout + done.stderr


def test_the_jobs_to_copy_give_the_action_what_it_takes() -> None:
    for name in ("github.yml", "github_px4.yml", "github_ardupilot.yml"):
        (job,) = yaml.safe_load((ROOT / "examples" / "ci" / name).read_text())["jobs"].values()
        step = next(step for step in job["steps"] if "mavproxy-fault" in step.get("uses", ""))
        assert step["with"].keys() <= ACTION["inputs"].keys()
    lab = yaml.safe_load((ROOT / "examples" / "ci" / "gitlab.yml").read_text())["sensor-faults"]
    assert lab["script"][-1].startswith("mavproxy-fault campaign ")
    build_parser("campaign").parse_args(lab["script"][-1].split()[1:])


def test_the_page_names_every_file_that_the_jobs_need() -> None:
    campaign = ROOT / "examples" / "ci" / "campaign.yaml"
    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    for scenario in yaml.safe_load(campaign.read_text())["scenarios"]:
        path = (campaign.parent / scenario).resolve().relative_to(ROOT)
        assert f"](../{path})" in page
    assert f"](../{campaign.relative_to(ROOT)})" in page


def test_the_action_installs_its_own_checkout(tmp_path: Path) -> None:
    step = next(step for step in ACTION["runs"]["steps"] if step["name"] == "Install")
    script = step["run"].replace("${{ inputs.python }}", str(tmp_path / "python"))
    # Both programs only write their arguments.
    pip = tmp_path / "mavproxy-fault" / "bin" / "pip"
    pip.parent.mkdir(parents=True)
    for program in (tmp_path / "python", pip):
        program.write_text('#!/bin/sh\necho "$@"\n')
        program.chmod(0o755)
    variables = {"RUNNER_TEMP": str(tmp_path), "GITHUB_ACTION_PATH": "/the/checkout"}
    cases = (
        ("", "", "/the/checkout"),
        ("./mine", "", "./mine"),
        ("", ". other", "/the/checkout . other"),
    )
    for version, packages, installed in cases:
        done = subprocess.run(
            ["bash", "-eo", "pipefail", "-c", script],
            env={**os.environ, **variables, "VERSION": version, "PACKAGES": packages},
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.splitlines()[-1] == f"install -q --no-compile {installed}"


@pytest.mark.parametrize(
    ("inputs", "message"),
    [({}, "give the input campaign or scenario"), ({"scenario": "none.yaml"}, "none.yaml")],
)
def test_what_is_wrong_fails_the_step(tmp_path: Path, inputs: dict[str, str], message: str) -> None:
    done = fly(tmp_path, **inputs)
    assert done.returncode == 2
    assert message in done.stderr


def test_every_input_of_the_action_is_used() -> None:
    used = {value for step in ACTION["runs"]["steps"] for value in step.get("env", {}).values()}
    text = (ROOT / "action.yml").read_text()
    for name in ACTION["inputs"]:
        assert f"${{{{ inputs.{name} }}}}" in used or text.count(f"inputs.{name} ") > 0
