"""Complete flights from Python: start one `mavproxy-fault run` and read its run folder."""

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mavproxy_fault.app.recorder import LABELS, RECEIVED, SENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.label import Label, read_labels
from mavproxy_fault.wire.tlog import Columns, read_columns

WRONG_INPUT = 2  # exit code of the command
Table = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Run:
    """A completed flight: the files of its run folder, read on first access.

    `report` is the page to open when a test fails.
    """

    folder: Path

    @property
    def report(self) -> Path:
        """The self-contained HTML page."""
        return self.folder / "report.html"

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`summary.json`: the verdict, the faults and the scores."""
        found: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return found

    @property
    def verdict(self) -> str:
        """PASS, FAIL or NO VERDICT."""
        return str(self.summary["verdict"])

    @cached_property
    def labels(self) -> list[Label]:
        """The applied faults: frames, times and magnitude of each."""
        return read_labels(self.folder / LABELS)

    @cached_property
    def results(self) -> dict[str, Table]:
        """The monitor's results by type: one array per key, one element per result.

        Numbers are float arrays (NaN for null); any other value makes an object array.
        """
        rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for line in (self.folder / "results.jsonl").read_text().splitlines():
            row = json.loads(line)
            rows[row.pop("type")].append(row)
        return {kind: result_table(found) for kind, found in rows.items()}

    @cached_property
    def columns(self) -> Columns:
        """Every message as it left the proxy: a structured array by name."""
        return read_columns(self.folder / SENT)

    @cached_property
    def received_columns(self) -> Columns:
        """Every message before the faults."""
        return read_columns(self.folder / RECEIVED)


def run(
    scenario: str | Path | dict[str, Any] | None = None,
    *,
    schedule: str | Path | dict[str, Any] | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    set: Mapping[str, Any] | None = None,
    estimators: Sequence[str] | None = None,
    autopilot: str | None = None,
    binary: str | Path | None = None,
) -> Run:
    """Run a scenario through proxy and monitor at full speed, in a separate process.

    It may therefore be called from any thread, and its workers never import the caller's module.

    Parameters
    ----------
    scenario, schedule : str, Path, dict or None
        Files or their content; default: the demo scenario, the scenario's own schedule.
    seed : int, optional
        Replaces the scenario's seed.
    out : str or Path, optional
        The run folder; default: a new temporary folder.
    set : mapping of str, optional
        Values of the scenario by path, such as `{"environment.wind_ned_mps[0]": 5}`.
    estimators : sequence of str, optional
        The attitude estimators to score; default: the scenario's.
    autopilot : str, optional
        `px4`, `ardupilot`, `ardupilot:copter` or `ardupilot:plane` flies; default: the simulator's
        controller.
    binary : str or Path, optional
        The autopilot's SITL program; default: that in the PATH.

    Raises
    ------
    ConfigError
        If the scenario or the schedule is wrong.
    RuntimeError
        If the flight ended without a result.
    """
    folder = output_folder(out)
    arguments = [] if scenario is None else [input_file(scenario, folder / "scenario.yaml")]
    if schedule is not None:
        arguments += ["--schedule", input_file(schedule, folder / "schedule.yaml")]
    for path, value in (set or {}).items():
        text = value if isinstance(value, str) else json.dumps(value)
        arguments += ["--set", f"{path}={text}"]
    given = {
        "seed": seed,
        "estimators": None if estimators is None else ",".join(estimators),
        "autopilot": autopilot,
        "binary": binary,
    }
    arguments += [f"--{name}={value}" for name, value in given.items() if value is not None]
    # Without Zenoh, whose single address parallel tests would compete for.
    arguments += ["--out", str(folder), "--zenoh", "off", "--speed", "max"]
    process = run_command("run", *arguments)
    # A FAIL writes a summary too; a missing one means that the flight itself crashed.
    check_written(folder / "summary.json", process.stderr)
    return Run(folder)


def run_command(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run one subcommand in a process of its own.

    Raises
    ------
    ConfigError
        If the command refuses its input.
    """
    # The same interpreter, so the same environment and packages; -P keeps files of the working
    # directory, such as an `analysis.py`, from being taken for packages.
    command = [sys.executable, "-P", "-m", "mavproxy_fault.cli", *arguments]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if process.returncode == WRONG_INPUT:
        # Without the prefix of the command, since the exception has its own.
        raise ConfigError(process.stderr.strip().removeprefix("mavproxy-fault: "))
    return process


def output_folder(out: str | Path | None) -> Path:
    """Create the output folder, a temporary folder if `out` is None."""
    folder = Path(out) if out is not None else Path(tempfile.mkdtemp(prefix="mavproxy-fault-"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def check_written(path: Path, said: str) -> None:
    """Check that a command wrote its results.

    Raises
    ------
    RuntimeError
        With what the command said.
    """
    if not path.exists():
        raise RuntimeError(f"{path.parent}: the command ended without a result:\n{said}")


def input_file(source: str | Path | dict[str, Any], path: Path) -> str:
    """Return the file's name; a dictionary is first written to `path`."""
    if not isinstance(source, dict):
        return str(source)
    path.write_text(yaml.safe_dump(source, sort_keys=False))
    return str(path)


def result_table(rows: list[dict[str, Any]]) -> Table:
    """Convert result rows with the same keys to one column per key."""
    return {key: result_column([row[key] for row in rows]) for key in rows[0]}


def result_column(values: list[Any]) -> NDArray[Any]:
    """Make one column: floats if all values are numbers or None, else objects."""
    if all(value is None or type(value) in (int, float) for value in values):
        return np.array([np.nan if value is None else value for value in values], float)
    # Filled in a second step, or numpy would make a 2-D array of lists of equal length.
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
