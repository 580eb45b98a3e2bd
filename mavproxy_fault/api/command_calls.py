"""Flights, campaigns, searches and reports from Python: start the command, read what it wrote.

Each runs in a process of its own, so it may be called from any thread, and its workers never
import the caller's module. A dictionary in the place of a file is written to the output folder;
its own file names are relative to the working directory. `out` is that folder, by default a new
temporary one; a campaign or a search continues in the folder of an earlier one.

A ConfigError says what is wrong with the input, a RuntimeError what a command without a result
said.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from mavproxy_fault.api.result_folders import Campaign, Report, Run, Search
from mavproxy_fault.documents.errors import ConfigError

WRONG_INPUT = 2  # exit code of the command
Document = str | Path | dict[str, Any]


def run(
    scenario: Document | None = None,
    *,
    schedule: Document | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    set: Mapping[str, Any] | None = None,
    estimators: Sequence[str] | None = None,
    autopilot: str | None = None,
    binary: str | Path | None = None,
    parameters: str | Path | None = None,
) -> Run:
    """Run a scenario through proxy and monitor at full speed.

    Parameters
    ----------
    scenario, schedule : str, Path, dict or None
        Files or their content; default: the demo scenario, the scenario's own schedule.
    seed : int, optional
        Replaces the scenario's seed.
    out : str or Path, optional
        The run folder.
    set : mapping of str, optional
        Values of the scenario by path, such as `{"environment.wind_ned_mps[0]": 5}`; the settings
        of a detector are below `monitor`.
    estimators : sequence of str, optional
        The attitude estimators to score; default: the scenario's.
    autopilot : str, optional
        `px4`, `ardupilot`, `ardupilot:copter` or `ardupilot:plane` flies; default: the simulator's
        controller.
    binary, parameters : str or Path, optional
        The autopilot's SITL program (default: that in the PATH) and parameter file.
    """
    values = {path: v if isinstance(v, str) else json.dumps(v) for path, v in (set or {}).items()}
    options: dict[str, object] = {
        "schedule": schedule,
        "seed": seed,
        "set": [f"{path}={value}" for path, value in values.items()],
        "estimators": None if estimators is None else ",".join(estimators),
        "autopilot": autopilot,
        "binary": binary,
        "parameters": parameters,
        # Without Zenoh, whose single address parallel tests would compete for.
        "zenoh": "off",
        "speed": "max",
    }
    # A FAIL writes a summary too; a missing one means that the flight itself crashed.
    return Run(_call("run", out, scenario, options, "summary.json")[0])


def campaign(
    file: Document, *, out: str | Path | None = None, workers: int | None = None
) -> Campaign:
    """Fly a campaign; `workers` is the number of processes, by default one for each processor."""
    options = {"workers": workers}
    folder, code = _call("campaign", out, file, options, "campaign-summary.json")
    return Campaign(folder, code == 0)


def search(
    file: Document,
    *,
    out: str | Path | None = None,
    budget: int | None = None,
    workers: int | None = None,
) -> Search:
    """Search the worst case of a test file with `budget` evaluations, by default the file's."""
    options = {"budget": budget, "workers": workers}
    return Search(_call("search", out, file, options, "search-summary.json")[0])


def report(
    log: str | Path, *, labels: str | Path | None = None, out: str | Path | None = None
) -> Report:
    """Write the report of a tlog, ULog or dataflash log, with the labels of its faults if given."""
    return Report(_call("report", out, log, {"labels": labels}, "summary.json")[0])


def monitor(
    log: str | Path,
    *,
    labels: str | Path | None = None,
    scenario: Document | None = None,
    out: str | Path | None = None,
) -> Run:
    """Detect and isolate faults in a log, with the monitor settings of `scenario` if given."""
    options = {"log": log, "labels": labels, "scenario": scenario}
    return Run(_call("monitor", out, None, options, "summary.json")[0])


def _call(
    command: str,
    out: str | Path | None,
    file: object,
    options: Mapping[str, object],
    result: str,
) -> tuple[Path, int]:
    """Run one command with the options that are not None; return its folder and exit code."""
    folder = Path(out) if out is not None else Path(tempfile.mkdtemp(prefix="mavproxy-fault-"))
    folder.mkdir(parents=True, exist_ok=True)
    arguments = [] if file is None else [_file_name("scenario", file, folder)]
    for name, value in options.items():
        if value is not None:
            for each in value if isinstance(value, list) else [value]:
                arguments.append(f"--{name}={_file_name(name, each, folder)}")
    # The same interpreter, so the same environment and packages; -P keeps files of the working
    # directory, such as an `analysis.py`, from being taken for packages.
    module = [sys.executable, "-P", "-m", "mavproxy_fault.cli"]
    line = [*module, command, *arguments, "--out", str(folder)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode == WRONG_INPUT:
        # Without the prefix of the command, since the exception has its own.
        raise ConfigError(done.stderr.strip().removeprefix("mavproxy-fault: "))
    if not (folder / result).exists():
        raise RuntimeError(f"{folder}: the command ended without a result:\n{done.stderr}")
    return folder, done.returncode


def _file_name(name: str, given: object, folder: Path) -> str:
    """Return the text of an argument; a document's content is first written to a file."""
    if not isinstance(given, dict):
        return str(given)
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(_find_files(given), sort_keys=False))
    return str(path)


def _find_files(value: Any) -> Any:
    """Make the names of files in a document absolute, as the document lies elsewhere."""
    if isinstance(value, dict):
        return {key: _find_files(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_find_files(one) for one in value]
    is_file = isinstance(value, str) and "." in value and Path(value).is_file()
    return str(Path(value).absolute()) if is_file else value
