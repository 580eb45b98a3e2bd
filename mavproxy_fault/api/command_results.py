"""Campaigns, searches and reports from Python: start the command and read what it wrote."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mavproxy_fault.api.flight_run import (
    Table,
    check_written,
    input_file,
    output_folder,
    result_table,
    run_command,
)


@dataclass(frozen=True)
class Campaign:
    """A completed campaign; `passed` is what the command's exit code says."""

    folder: Path
    passed: bool

    @property
    def page(self) -> Path:
        """The self-contained HTML page with the heat map."""
        return self.folder / "campaign.html"

    @cached_property
    def cells(self) -> Table:
        """The results of the cells: one array per key, one element per cell."""
        results = map(json.loads, (self.folder / "cells.jsonl").read_text().splitlines())
        # A cell that was aborted first and flown later stands twice; the last one counts.
        rows = {json.dumps(row["cell"]): {**row.pop("cell"), **row} for row in results}
        return result_table(list(rows.values()))

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`campaign-summary.json`: counts of outcomes and critical magnitudes."""
        return read_json(self.folder / "campaign-summary.json")


@dataclass(frozen=True)
class Search:
    """A completed search."""

    folder: Path

    @cached_property
    def cases(self) -> list[dict[str, Any]]:
        """The worst cases found, worst first."""
        cases: list[dict[str, Any]] = read_json(self.folder / "search-summary.json")["cases"]
        return cases


@dataclass(frozen=True)
class Report:
    """The report of a log."""

    folder: Path

    @property
    def page(self) -> Path:
        """The self-contained HTML page."""
        return self.folder / "report.html"

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`summary.json`: the verdict and the checks."""
        return read_json(self.folder / "summary.json")

    @property
    def verdict(self) -> str:
        """PASS, WARN, FAIL or NO VERDICT."""
        return str(self.summary["verdict"])


def campaign(
    file: str | Path | dict[str, Any],
    *,
    out: str | Path | None = None,
    workers: int | None = None,
) -> Campaign:
    """Fly a campaign, or continue the one in `out`.

    Parameters
    ----------
    file : str, Path or dict
        A campaign file or its content, whose scenario files are then relative to `out`.
    out : str or Path, optional
        Its folder; default: a new temporary folder.
    workers : int, optional
        Processes; default: one for each processor.

    Raises
    ------
    ConfigError
        If the campaign is wrong, or a reference flight failed.
    RuntimeError
        If it ended without results.
    """
    folder = output_folder(out)
    arguments = [input_file(file, folder / "campaign.yaml"), "--out", str(folder)]
    if workers is not None:
        arguments += ["--workers", str(workers)]
    done = run_command("campaign", *arguments)
    check_written(folder / "campaign-summary.json", done.stderr)
    return Campaign(folder, done.returncode == 0)


def search(
    file: str | Path | dict[str, Any],
    *,
    out: str | Path | None = None,
    budget: int | None = None,
    workers: int | None = None,
) -> Search:
    """Search the worst case of a test file, or continue the search in `out`.

    Parameters and errors as in `campaign`; `budget` is the number of evaluations, by default that
    of the test file.
    """
    folder = output_folder(out)
    arguments = [input_file(file, folder / "test.yaml"), "--out", str(folder)]
    for name, value in (("budget", budget), ("workers", workers)):
        if value is not None:
            arguments += [f"--{name}", str(value)]
    check_written(folder / "search-summary.json", run_command("search", *arguments).stderr)
    return Search(folder)


def report(
    log: str | Path, *, labels: str | Path | None = None, out: str | Path | None = None
) -> Report:
    """Write the report of a tlog, ULog or dataflash log, with the labels of its faults if given.

    Errors as in `campaign`.
    """
    folder = output_folder(out)
    arguments = [str(log), "--out", str(folder)]
    if labels is not None:
        arguments += ["--labels", str(labels)]
    check_written(folder / "summary.json", run_command("report", *arguments).stderr)
    return Report(folder)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object."""
    found: dict[str, Any] = json.loads(path.read_text())
    return found
