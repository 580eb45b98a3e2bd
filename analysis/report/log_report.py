"""The files of one report: page, summary, JUnit XML, and what the options of `report` add."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from analysis.report.comparison import comparison_tables, overlay_flights
from analysis.report.export_tracks import FORMS as TRACK_FORMS
from analysis.report.export_tracks import export_tracks
from analysis.report.flight_verdict import FlightAssessment, assess_flight
from analysis.report.judging.check_limits import read_thresholds
from analysis.report.page.field_data import INSIDE_MB, field_data
from analysis.report.page.log_page import log_page
from analysis.report.page.page_file import page_html
from analysis.report.page.pdf_file import write_pdf
from analysis.report.recordings.flight_sources import read_flight
from analysis.report.report_files import write_junit
from analysis.report.run_folder import write_summary
from mavproxy_fault.documents.atomic_file import write_atomic
from mavproxy_fault.documents.errors import users_path
from mavproxy_fault.wire.label import Label


def report_flight(
    paths: Sequence[Path],
    folder: Path,
    args: argparse.Namespace,
    labels: Sequence[Label] = (),
    others: Sequence[FlightAssessment] = (),
) -> FlightAssessment:
    """Write the report on one flight to `folder`, with what the options of `report` ask for.

    Raises
    ------
    ConfigError
        If a log cannot be read, or the folder not be written.
    """
    references = [other.flight.recording for other in others]
    thresholds = read_thresholds(args.criteria)
    outcome = assess_flight(read_flight(paths, labels), thresholds, references)
    with users_path(f"--out {folder}", "give a writable folder"):
        folder.mkdir(parents=True, exist_ok=True)
    write_report(folder, outcome, others, args.data)
    recording = outcome.flight.recording
    # Imported on demand: Matplotlib and Arrow load slowly.
    if args.figures:
        from analysis.report.page.figures import write_figures

        write_figures(folder / "figures", recording)
    if args.export in TRACK_FORMS:
        export_tracks(recording, folder / "export", args.export)
    elif args.export:
        from analysis.report.export import export_tables

        export_tables(paths, folder / "export", args.export, recording)
    # The browser prints the page written before.
    if args.pdf:
        write_pdf(folder / "report.html")
    return outcome


@np.errstate(invalid="ignore", over="ignore")  # a log may hold any bits as a number
def write_report(
    folder: Path,
    outcome: FlightAssessment,
    others: Sequence[FlightAssessment],
    data: str = str(INSIDE_MB),
) -> None:
    """Write `report.html`, `summary.json` and `junit.xml`; `data` is the option `--data`."""
    recording = overlay_flights(outcome, others) if others else outcome.flight.recording
    tables = comparison_tables(outcome, others) if others else []
    page = log_page(outcome, tables)
    fields = field_data(recording.messages, data, folder)
    write_atomic(folder / "report.html", page_html(page, recording, fields))
    write_summary(folder, outcome.summary)
    write_junit(folder / "junit.xml", recording.name, outcome.checks)
