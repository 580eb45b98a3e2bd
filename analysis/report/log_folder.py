"""Report on a folder of logs: one report per log, in parallel, and an index page.

`index.json` stores the state of each log, so that repeating the command reads only new or changed
logs.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from analysis.processes import fork_context, spawn_context
from analysis.report.judging.checks import worst_first
from analysis.report.log_report import report_flight
from analysis.report.page.index_page import UNREADABLE, index_html
from analysis.report.recordings.flight_sources import is_run_folder
from analysis.report.recordings.log_paths import PACKED, log_file
from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.documents.errors import ConfigError

LOGS = (".tlog", ".ulg", ".bin", ".log")
WORST_SHOWN = 3  # checks shown per flight

Row = dict[str, Any]


def report_folder(folder: Path, args: argparse.Namespace) -> int:
    """Report on every log in a folder and its subfolders; returns the exit code of `report`.

    Raises
    ------
    ConfigError
        If there is no log.
    """
    out = Path(args.out) if args.out else Path(f"{folder.resolve().name}-report")
    logs = {
        # Exclude the output folder, which may be within the folder of logs.
        str(path.relative_to(folder)): path
        for path in _logs(folder)
        if out not in path.parents
    }
    if not logs:
        known = ", ".join(LOGS)
        raise ConfigError(f"{folder}: no logs in the folder; it may hold {known}, or run folders")
    # Logs that have not changed since an earlier call are not read again.
    before = _index(out / "index.json")
    marks = {name: _mark(path, args) for name, path in logs.items()}
    rows = {
        name: before[name]["row"]
        for name in logs
        if name in before and before[name]["mark"] == marks[name]
    }
    new = {name: path for name, path in logs.items() if name not in rows}
    try:
        for name, row in _report_all(new, out, args):
            rows[name] = row
    finally:  # keep finished reports, also after Ctrl-C
        _write(out, folder, {name: {"mark": marks[name], "row": rows[name]} for name in rows})
    text = f"{len(rows)} flight{'s' * (len(rows) != 1)} ({len(new)} new): {out / 'index.html'}"
    print_result(args, {"flights": rows, "index": out / "index.html"}, text)
    verdicts = {row["verdict"] for row in rows.values()}
    # Unreadable takes precedence over failed.
    return 2 if UNREADABLE in verdicts else int("FAIL" in verdicts)


def _logs(folder: Path) -> Iterator[Path]:
    """Logs by their suffixes, and run folders, in order; files in a run folder belong to it."""
    if is_run_folder(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from _logs(path)
        else:
            # `flight.bin.gz` is a dataflash log: the inner suffix decides.
            inner = path.with_suffix("") if path.suffix.lower() in PACKED else path
            if inner.suffix.lower() in LOGS:
                yield path


def _mark(path: Path, args: argparse.Namespace) -> list[Any]:
    """Key of a report's inputs: the state of the file, and the options."""
    files = [path] if path.is_file() else [p for p in sorted(path.iterdir()) if p.is_file()]
    # Size and modification time, as a digest of gigabytes is slow.
    stats = [(file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    criteria = Path(args.criteria).read_text("utf-8") if args.criteria else ""
    return [[list(stat) for stat in stats], criteria, args.data]


def _index(path: Path) -> Mapping[str, Any]:
    try:
        return dict(json.loads(path.read_text("utf-8")))
    except (OSError, ValueError):
        # Without a readable index all logs are reported again.
        return {}


def _report_all(
    logs: Mapping[str, Path], out: Path, args: argparse.Namespace
) -> Iterator[tuple[str, Row]]:
    """Report on all logs in parallel, with a progress bar; yields names and rows as they finish."""
    from rich.console import Console
    from rich.progress import track

    context = fork_context() or spawn_context()
    # The pool needs at least one worker.
    with ProcessPoolExecutor(min(len(logs) or 1, os.cpu_count() or 1), context) as pool:
        jobs = {
            pool.submit(_report_one, path, out, name, args): name for name, path in logs.items()
        }
        bar = Console(stderr=True)
        every = track(
            as_completed(jobs), "logs", len(jobs), console=bar, disable=not sys.stderr.isatty()
        )
        for job in every:
            yield jobs[job], job.result()


def _report_one(path: Path, out: Path, name: str, args: argparse.Namespace) -> Row:
    """Write one report in a worker process; returns its row of the index."""
    # A single level of folders: `a/b.ulg` becomes `a-b.ulg`.
    folder = out / name.replace(os.sep, "-")
    try:
        # Compressed logs are unpacked here and read before the folder is deleted.
        with tempfile.TemporaryDirectory() as unpacked:
            outcome = report_flight([log_file(path, Path(unpacked))], folder, args)
    except ConfigError as error:
        # An unreadable log becomes a row of the index.
        failed = {"verdict": UNREADABLE, "duration_s": None, "autopilot": ""}
        return {"name": name, "report": "", "worst": [str(error)], **failed}
    bad = worst_first(outcome.checks)
    recording = outcome.flight.recording
    return {
        "name": name,
        "report": f"{folder.name}/report.html",
        "verdict": outcome.verdict,
        "duration_s": recording.duration_s,
        "autopilot": recording.autopilot,
        "worst": [f"{check.verdict} {check.name}: {check.evidence}" for check in bad[:WORST_SHOWN]],
    }


def _write(out: Path, folder: Path, index: Mapping[str, Any]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    # Rewritten each time, as it is small.
    (out / "index.json").write_text(json.dumps(index, indent=1), encoding="utf-8")
    rows = [index[name]["row"] for name in sorted(index)]
    title = f"Flights of {folder.resolve().name}"
    (out / "index.html").write_text(index_html(title, rows), encoding="utf-8")
