"""`mavproxy-fault report`: logs to HTML, JSON and JUnit XML; the exit code is the verdict."""

import argparse
import sys
import tempfile
from pathlib import Path

import msgspec

from analysis.report.flight_verdict import FlightAssessment, assess_flight
from analysis.report.judging.check_limits import read_thresholds
from analysis.report.judging.checks import FAIL, chain_text, worst_first
from analysis.report.log_folder import report_folder
from analysis.report.log_report import report_flight
from analysis.report.recordings.flight_sources import group_logs, is_run_folder, read_flight
from analysis.report.recordings.log_paths import log_file, log_files
from analysis.scoring.vehicle_outcome import VehicleOutcome, describe_vehicle
from mavproxy_fault.app.command_result import open_console, print_result
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.label import read_labels


def main(args: argparse.Namespace) -> int:
    """Report on each flight; returns 0 if none failed, 1 if one failed, 2 if a file cannot be read.

    Each of several flights has its own folder; an unreadable file does not stop the others. A
    folder of logs has an index page.
    """
    first = Path(args.logs[0])
    # A run folder is one flight.
    if len(args.logs) == 1 and first.is_dir() and not is_run_folder(first):
        return report_folder(first, args)
    # Compressed logs are unpacked here and read before the folder is deleted.
    with tempfile.TemporaryDirectory() as unpacked:
        return _report_each(args, Path(unpacked))


def _report_each(args: argparse.Namespace, unpacked: Path) -> int:
    thresholds = read_thresholds(args.criteria)
    labels = read_labels(Path(args.labels)) if args.labels else []
    against = [log_file(Path(log), unpacked) for log in args.against]
    # Labels belong to the reported flights, not to those that they are compared with.
    others = [assess_flight(read_flight([log], ()), thresholds) for log in against]
    paths, unreadable = log_files([Path(log) for log in args.logs], unpacked)
    flights = group_logs(paths)
    failed, rows = False, []
    for flight_paths in flights:
        stem = _stem(flight_paths[0])
        folder = Path(args.out or f"{stem}-report")
        # With `--out` and several flights, each needs its own folder.
        if args.out and len(args.logs) > 1 and len(flights) > 1:
            folder = folder / stem
        try:
            outcome = report_flight(flight_paths, folder, args, labels, others)
        # The error of one flight among several does not stop the others.
        except ConfigError as error:
            if len(flights) == 1:
                raise
            unreadable.append(str(error))
            continue
        if not args.json:
            print_outcome(outcome, folder)
        rows.append({**outcome.summary, "folder": folder})
        failed |= outcome.verdict == FAIL
    if args.json:
        print_result(args, {"flights": rows, "unreadable": unreadable}, "")
    for message in unreadable:
        print(f"mavproxy-fault: {message}", file=sys.stderr)
    return 2 if unreadable else int(failed)


def _stem(path: Path) -> str:
    # The path of a run folder may end in `..`.
    return path.stem if path.is_file() else path.resolve().name


def print_outcome(outcome: FlightAssessment, folder: Path) -> None:
    """Print the verdict, warnings, failures and faults on the terminal."""
    from rich.text import Text

    console = open_console()
    console.soft_wrap = True
    colours = {"PASS": "green", "WARN": "yellow", "FAIL": "red"}
    recording = outcome.flight.recording
    console.print(Text(recording.name, "bold"), f" {recording.duration_s:.0f} s")
    found = msgspec.convert(outcome.summary["outcome"], VehicleOutcome)
    console.print(f"  vehicle {describe_vehicle(found)}")
    for check in worst_first(outcome.checks):
        word = Text(check.verdict, colours[check.verdict])
        console.print(" ", word, f" {check.name}: {check.evidence}")
    if order := chain_text(outcome.checks):
        console.print(f"  in order: {order}")
    passed = sum(check.verdict == "PASS" for check in outcome.checks)
    unjudged = sum(check.verdict == "not judged" for check in outcome.checks)
    console.print(f"  {passed} checks passed, {unjudged} without data")
    for row in outcome.summary["faults"]:
        delay = "" if row["delay_s"] is None else f" after {row['delay_s']:.2f} s"
        console.print(f"  fault {row['id']}: {row['verdict']}{delay}")
    verdict = Text(outcome.verdict, colours.get(outcome.verdict, "white"))
    console.print("  verdict", verdict, f" {folder / 'report.html'}")
