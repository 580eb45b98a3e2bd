"""What flights, campaigns, searches and reports leave in their folders, read on first access."""

import json
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from html import escape
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.app.recorder import LABELS, RECEIVED, SENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.wire.label import Label, read_labels
from mavproxy_fault.wire.tlog import Columns, read_columns

Table = dict[str, NDArray[Any]]
COLOURS = {"PASS": "#2a7", "isolated": "#2a7", "detected": "#2a7", "unaffected": "#2a7"}


@dataclass(frozen=True)
class Report:
    """The report of a flight or a log; a notebook shows its verdict and faults."""

    folder: Path

    @property
    def page(self) -> Path:
        """The self-contained HTML page to open."""
        return self.folder / "report.html"

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`summary.json`: the verdict, the faults, the checks and scores."""
        return _read_json(self.folder / "summary.json")

    @property
    def verdict(self) -> str:
        """PASS, WARN, FAIL or NO VERDICT."""
        return str(self.summary["verdict"])

    def _repr_html_(self) -> str:
        keys = ("id", "target", "start_s", "end_s", "delay_s", "verdict")
        rows = [[fault.get(key) for key in keys] for fault in self.summary["faults"]]
        return _html_table(f"{self.verdict} · {self.page}", keys, rows)


@dataclass(frozen=True)
class Run(Report):
    """A flight, or a recording that the monitor has read."""

    @property
    def report(self) -> Path:
        """The self-contained HTML page to open; the same file as `page`."""
        return self.page

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
        for row in _read_lines(self.folder / "results.jsonl"):
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

    def frame(self, name: str, *, received: bool = False) -> Any:
        """Return a message as sent (or `received`), or a type of result, as a data frame.

        The frame is pandas', or polars' if only that is installed.
        """
        if name in self.results:
            return data_frame(self.results[name])
        rows = (self.received_columns if received else self.columns)[name]
        return data_frame({key: rows[key] for key in rows.dtype.names or ()})

    def plot(self, *fields: str) -> Any:
        """Draw fields such as `HIL_SENSOR.xgyro` before and after the faults (matplotlib)."""
        pyplot = import_extra("matplotlib.pyplot")
        figure, axes = pyplot.subplots(
            len(fields),
            squeeze=False,
            sharex=True,
            layout="constrained",
            figsize=(8, 2 * len(fields)),
        )
        t0_us = min(rows["t_us"][0] for rows in self.columns.values() if len(rows))
        for axis, target in zip(axes[:, 0], fields, strict=True):
            message, _, field = target.partition(".")
            for columns, name in ((self.columns, "sent"), (self.received_columns, "received")):
                rows = columns[message]
                axis.plot((rows["t_us"] - t0_us) * 1e-6, rows[field], label=name, linewidth=0.8)
            for label in self.labels:
                end_us = rows["t_us"][-1] if label.end_us is None else label.end_us
                begin_s, end_s = ((t_us - label.t0_us) * 1e-6 for t_us in (label.start_us, end_us))
                axis.axvspan(begin_s, end_s, color="tab:red", alpha=0.12)
            axis.set_ylabel(target)
            axis.legend(loc="upper right")
        axes[-1, 0].set_xlabel("vehicle time [s]")
        return figure


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
        # A cell that was aborted first and flown later stands twice; the last one counts.
        rows = {
            json.dumps(row["cell"]): {**row.pop("cell"), **row}
            for row in _read_lines(self.folder / "cells.jsonl")
        }
        return result_table(list(rows.values()))

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`campaign-summary.json`: counts of outcomes and critical magnitudes."""
        return _read_json(self.folder / "campaign-summary.json")

    def frame(self) -> Any:
        """Return the cells as a data frame of pandas or polars."""
        return data_frame(self.cells)

    def _repr_html_(self) -> str:
        keys = ("subject", "fault", "magnitude", "onset", "seed", "outcome")
        columns = [self.cells[key] for key in keys]
        return _html_table(str(self.page), keys, list(zip(*columns, strict=True)))


@dataclass(frozen=True)
class Search:
    """A completed search."""

    folder: Path

    @cached_property
    def cases(self) -> list[dict[str, Any]]:
        """The worst cases found, worst first."""
        cases: list[dict[str, Any]] = _read_json(self.folder / "search-summary.json")["cases"]
        return cases

    def frame(self) -> Any:
        """Return the worst cases as a data frame of pandas or polars, one column per variable."""
        return data_frame(result_table([{**case, **case["values"]} for case in self.cases]))


def data_frame(table: Table) -> Any:
    """Make a data frame of columns; each row of an array field is a list.

    Raises
    ------
    ConfigError
        If neither pandas nor polars is installed.
    """
    flat = {key: list(values) if values.ndim > 1 else values for key, values in table.items()}
    for package in ("pandas", "polars"):
        if find_spec(package) is not None:
            return import_module(package).DataFrame(flat)
    raise ConfigError("frame: neither pandas nor polars is installed; run pip install pandas")


def _html_table(title: str, keys: tuple[str, ...], rows: list[Any]) -> str:
    """Make the table that a notebook shows; the last column is coloured by its word."""
    body = ""
    for *cells, last in rows:
        colour = COLOURS.get(last, "#c33")
        words = "".join(f"<td>{escape(str(cell))}</td>" for cell in cells)
        body += f"<tr>{words}<td style='color:{colour}'>{escape(str(last))}</td></tr>"
    head = "".join(f"<th>{key}</th>" for key in keys)
    return f"<b>{escape(title)}</b><table><tr>{head}</tr>{body}</table>"


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


def _read_json(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def _read_lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]
