"""A run's report: `write` for the commands that have everything in memory."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from analysis.report.from_results import isolation_matrix, recording_of_results
from analysis.report.from_tlog import recording_of
from analysis.report.page import Page, Table, html
from analysis.report.panels import DETECTION
from analysis.report.recording import Recording
from analysis.results import Result
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.tlog import Columns


def write(
    out: Path,
    *,
    summary: Mapping[str, Any],
    labels: Sequence[Label],
    results: Iterable[Result],
    columns: Columns,
    title: str = "Run",
) -> Path:
    """Write `report.html` into the folder `out`.

    Parameters
    ----------
    out : Path
        An existing folder.
    summary : mapping
        The content of `summary.json`.
    labels, results
        What was really done, and what the analysis said.
    columns : dict of structured arrays
        The log as received (`mavproxy_fault.wire.tlog.read_columns`); empty where there is none.

    Returns
    -------
    Path
        The file written.
    """
    results = list(results)
    t0_us = labels[0].t0_us if labels else _origin(results)
    flight = recording_of(columns, name=title, t0_us=t0_us) if columns else Recording(title)
    if t0_us is None:
        t0_us = flight.t0_us
    said = recording_of_results(labels, results, t0_us)
    together = joined(flight, said)
    page = Page(title, str(summary.get("verdict", "")), _facts(summary), _tables(summary))
    matrix = _matrix(labels, results)
    if matrix is not None:
        page = Page(page.title, page.verdict, page.facts, [*page.tables, (DETECTION, matrix)])
    path = out / "report.html"
    path.write_text(html(page, together), encoding="utf-8")
    return path


def joined(first: Recording, second: Recording) -> Recording:
    """Two recordings on one axis as one."""
    return Recording(
        first.name,
        first.autopilot or second.autopilot,
        first.t0_us,
        max(first.duration_s, second.duration_s),
        first.signals + second.signals,
        first.spans + second.spans,
        sorted(first.events + second.events, key=lambda event: event.t_s),
        first.tracks + second.tracks,
        first.links + second.links,
        first.parameters | second.parameters,
        first.notes + second.notes,
    )


def _origin(results: Sequence[Result]) -> int | None:
    """The vehicle time of t_s = 0, from a result that gives both."""
    return round(results[0].t_us - results[0].t_s * 1e6) if results else None


def _facts(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    facts = []
    attitude = summary.get("attitude_rmse_deg")
    rows = summary.get("faults") or []
    hours = (summary.get("sim_s") or 0) / 3600
    false_alarms = summary.get("false_alarms")
    if rows:
        seen = sum(bool(row["detected"]) for row in rows)
        facts.append(("faults detected", f"{seen} of {len(rows)}"))
        delays = [row["delay_s"] for row in rows if row["delay_s"] is not None]
        if delays:
            facts.append(("longest detection delay", f"{max(delays):.2f} s"))
    if false_alarms is not None:
        facts.append(("false alarms", str(false_alarms)))
        if hours > 0:
            facts.append(("false alarms per hour", f"{false_alarms / hours:.1f}"))
    if summary.get("epochs") is not None:
        facts.append(("GNSS epochs", str(summary["epochs"])))
    if summary.get("untestable_epochs") is not None:
        facts.append(("epochs untestable", str(summary["untestable_epochs"])))
    if attitude:
        facts.append(("attitude RMSE, worst axis", f"{attitude['max']:.2f}°"))
    if summary.get("position_rmse_m") is not None:
        facts.append(("position RMSE", f"{summary['position_rmse_m']:.2f} m"))
    if summary.get("sim_s"):
        facts.append(("flight", f"{summary['sim_s']:.0f} s"))
    return facts


def _tables(summary: Mapping[str, Any]) -> list[tuple[str, Table]]:
    tables = []
    rows = summary.get("faults") or []
    if rows:
        head = ("fault", "target", "from, s", "to, s", "frames", "delay, s", "blamed", "verdict")
        cells = [
            (
                str(row["id"]),
                str(row["target"]),
                _short(row["start_s"]),
                _short(row["end_s"]),
                str(row["frames"]),
                _short(row["delay_s"]),
                ", ".join(row["isolated"]),
                (str(row["verdict"]), str(row["verdict"])),
            )
            for row in rows
        ]
        tables.append(("", Table("Injected against detected", head, cells)))
    checks = summary.get("criteria") or []
    if checks:
        words = {True: "PASS", False: "FAIL", None: "not judged"}
        cells_ = [
            (
                str(check["name"]),
                "" if check["value"] is None else str(check["value"]),
                str(check["limit"]),
                (words[check["passed"]], words[check["passed"]]),
            )
            for check in checks
        ]
        tables.append(("", Table("Criteria", ("criterion", "found", "limit", "verdict"), cells_)))
    return tables


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _matrix(labels: Sequence[Label], results: Sequence[Result]) -> Table | None:
    """Decisions by what really acted, shaded by share of the row."""
    heads, counts = isolation_matrix(labels, results)
    if not heads:
        return None
    rows = [(name, *(str(count) if count else "" for count in row)) for name, row in counts.items()]
    note = "GNSS epochs by what acted (rows) and what the detector said or excluded (columns)."
    return Table("Isolation matrix", ("acted", *heads), rows, note, style="matrix")
