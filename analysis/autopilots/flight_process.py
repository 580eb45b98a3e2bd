"""`run --autopilot` as a child process, for campaigns and searches.

Each flight is a process group with its own ports and folder, so flights do not affect each other;
it ends with the worker that started it.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mavproxy_fault.ardupilot.child_process import die_with_parent
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import write_yaml

EXIT_WRONG_INPUT = 2
ERROR_LINES = 3
MAX_TRIES = 3  # on a busy machine the operator's timeouts may end a flight before its fault
RUN_FOLDER = "run"  # the run folder inside the flight's folder


def run_flight_process(
    subject: str, run: Sequence[str], schedule: dict[str, Any], folder: Path, *, kept: bool
) -> Path:
    """Run `mavproxy-fault run` with the arguments `run` and a schedule, with logs in `folder` and a
    report if `kept`; return the run folder.

    Raises
    ------
    ConfigError
        If the command refuses the scenario or the autopilot, or writes no summary.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run_folder = folder / RUN_FOLDER
    faults = folder / "schedule.yaml"
    faults.write_text(write_yaml(schedule))
    arguments = ["run", *run, "--schedule", str(faults), "--seed", str(schedule["seed"])]
    arguments += ["--out", str(run_folder), "--zenoh", "off"]
    if not kept:
        arguments += ["--no-report"]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "mavproxy_fault.cli", *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=die_with_parent,
    )
    if done.returncode == EXIT_WRONG_INPUT or not (run_folder / "summary.json").is_file():
        # The last lines of its output give the reason.
        last = done.stderr.strip().splitlines()[-ERROR_LINES:]
        raise ConfigError(f"{subject}: the flight failed; {' '.join(last)}")
    return run_folder


def repeat_flight_process(
    subject: str,
    run: Sequence[str],
    schedule: dict[str, Any],
    folder: Path,
    *,
    kept: bool,
    must_act: bool = False,
) -> tuple[Path, dict[str, Any]]:
    """Run `run_flight_process` until the vehicle has taken off and, with `must_act`, a fault has
    acted; return the run folder and its summary.

    Raises
    ------
    ConfigError
        If no try has, or as `run_flight_process` does.
    """
    for _ in range(MAX_TRIES):
        run_folder = run_flight_process(subject, run, schedule, folder, kept=kept)
        summary = json.loads((run_folder / "summary.json").read_text())
        took_off = "take-off" in summary["autopilot"]["moments_s"]
        if took_off and (summary["faults"] or not must_act):
            return run_folder, summary
        shutil.rmtree(run_folder)
    problem = "the fault never acted" if took_off else "the vehicle did not take off"
    reason = summary["autopilot"]["ended_early"]
    raise ConfigError(f"{subject}: {problem} in {MAX_TRIES} tries; {reason}")
