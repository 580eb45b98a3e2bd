"""Reports on a folder of logs: a report each, made side by side, and an index page of them all.

`index.json` keeps what each log was like, so that the same command again reads only what is new or
has changed.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from analysis.processes import spawn_context
from analysis.report.judging.checks import RANK
from analysis.report.page.index_page import UNREADABLE, index_html
from analysis.report.recordings.log_paths import PACKED
from mavproxy_fault.documents.errors import ConfigError

LOGS = (".tlog", ".ulg", ".bin", ".log")
RUN_LOGS = ("sent.tlog", "received.tlog")
WORST_SHOWN = 3  # checks shown of a flight

Row = dict[str, Any]


def is_run_folder(folder: Path) -> bool:
    """Whether a folder is that of one run."""
    return any((folder / name).is_file() for name in RUN_LOGS)


def report_folder(folder: Path, args: argparse.Namespace) -> int:
    """Report on every log in a folder and below; the exit code, as of `report`.

    Raises
    ------
    ConfigError
        If there is no log.
    """
    out = Path(args.out) if args.out else Path(f"{folder.resolve().name}-report")
    logs = {
        # A report folder inside the folder of logs would otherwise be taken for logs the next time.
        str(path.relative_to(folder)): path
        for path in _logs(folder)
        if out not in path.parents
    }
    if not logs:
        known = ", ".join(LOGS)
        raise ConfigError(f"{folder}: no logs in the folder; it may hold {known}, or run folders")
    # Before any work: what an earlier call reported and has not changed since is not read again.
    before = _index(out / "index.json")
    marks = {name: _mark(path, args) for name, path in logs.items()}
    rows = {name: before[name]["row"] for name in logs if _is_known(before.get(name), marks[name])}
    new = {name: path for name, path in logs.items() if name not in rows}
    try:
        for name, row in _report_all(new, out, args):
            rows[name] = row
    finally:  # what is done is kept, also after Ctrl-C
        _write(out, folder, {name: {"mark": marks[name], "row": rows[name]} for name in rows})
    print(f"{len(rows)} flights, {len(new)} of them new: {out / 'index.html'}")
    verdicts = {row["verdict"] for row in rows.values()}
    # Unreadable outranks failed: the exit code must not hide that something was not judged.
    return 2 if UNREADABLE in verdicts else int("FAIL" in verdicts)


def _logs(folder: Path) -> Iterator[Path]:
    """Logs by their endings, and run folders, in order; what lies in a run folder belongs to it."""
    if is_run_folder(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from _logs(path)
        else:
            # `flight.bin.gz` is a DataFlash log: the inner ending decides.
            inner = path.with_suffix("") if path.suffix.lower() in PACKED else path
            if inner.suffix.lower() in LOGS:
                yield path


def _mark(path: Path, args: argparse.Namespace) -> list[Any]:
    """What a report depends on: the file as it is now, and the options."""
    files = [path] if path.is_file() else [p for p in sorted(path.iterdir()) if p.is_file()]
    # Size and time of change instead of a digest: a fleet's logs are gigabytes.
    stats = [(file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    criteria = Path(args.criteria).read_text("utf-8") if args.criteria else ""
    return [[list(stat) for stat in stats], criteria, args.data]


def _index(path: Path) -> Mapping[str, Any]:
    try:
        found: Mapping[str, Any] = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        # A missing or broken index only costs time: everything is reported anew.
        return {}
    return found


def _is_known(entry: Mapping[str, Any] | None, mark: list[Any]) -> bool:
    return entry is not None and entry["mark"] == mark


def _report_all(
    logs: Mapping[str, Path], out: Path, args: argparse.Namespace
) -> Iterator[tuple[str, Row]]:
    """Names and rows as the reports are done, on all cores, with a bar on a terminal."""
    from rich.console import Console
    from rich.progress import track

    context = spawn_context()
    # At least one worker: the pool refuses none, also when nothing is new.
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
    """One report, in a process of its own; a row of the index."""
    # Imported in the child, since the command itself imports this module.
    from analysis.report.report_command import report_on

    # One level of folders: `a/b.ulg` becomes `a-b.ulg`, so that links need no `..`.
    folder = out / name.replace(os.sep, "-")
    try:
        outcome = report_on(path, folder, args)
    except ConfigError as error:
        # A log that cannot be read is a row of the index, not the end of the fleet.
        words = {"verdict": UNREADABLE, "worst": [str(error)]}
        return {"name": name, "report": "", "duration_s": None, "autopilot": ""} | words
    bad = [check for check in outcome.checks if check.verdict in ("WARN", "FAIL")]
    bad.sort(key=lambda check: -RANK[check.verdict])
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
    # Written whole each time; the rows are small beside the reports.
    (out / "index.json").write_text(json.dumps(index, indent=1), encoding="utf-8")
    rows = [index[name]["row"] for name in sorted(index)]
    title = f"Flights of {folder.resolve().name}"
    (out / "index.html").write_text(index_html(title, rows), encoding="utf-8")
