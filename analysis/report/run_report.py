"""Write the report page of a run, for commands with all data in memory."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.curves.panels import DETECTION
from analysis.report.curves.recording import FlightData, join_recordings
from analysis.report.page.field_data import INSIDE_MB, field_data
from analysis.report.page.page_file import page_html
from analysis.report.page.page_parts import SENSOR_LIMIT, ReportPage
from analysis.report.page.report_tables import (
    criteria_reasons,
    result_tables,
    run_facts,
    run_tables,
)
from analysis.report.recordings.from_results import axis_start, recording_of_results
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.results import Result
from mavproxy_fault.documents.atomic_file import write_atomic
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.tlog import Columns

NOTHING_BESIDE = FlightData("")


def write_run_report(
    out: Path,
    *,
    summary: Mapping[str, Any],
    labels: Sequence[Label],
    results: Iterable[Result],
    columns: Columns,
    title: str = "Run",
    beside: FlightData = NOTHING_BESIDE,
    pictures: Sequence[tuple[str, bytes]] = (),
) -> Path:
    """Write `report.html` into the existing folder `out`, and return its path.

    `summary` is the content of `summary.json`, `columns` the received log
    (`mavproxy_fault.wire.tlog.read_columns`; empty if there is none). `beside` adds curves and
    tracks, of which errors refer to the one named `truth`; `pictures` (title, SVG) stand beside the
    satellite plots.
    """
    results = list(results)
    t0_us = axis_start(labels, results)
    flight = recording_of_tlog(columns, name=title, t0_us=t0_us) if columns else FlightData(title)
    if t0_us is None:
        t0_us = flight.t0_us
    analysed = recording_of_results(labels, results, t0_us)
    together = add_derived_curves(join_recordings(join_recordings(flight, analysed), beside))
    tables = run_tables(summary) + result_tables(labels, results, together)
    reasons, verdict = criteria_reasons(summary), str(summary.get("verdict", ""))
    shown = [(DETECTION, *picture) for picture in pictures]
    page = ReportPage(title, verdict, run_facts(summary), tables, SENSOR_LIMIT, reasons, shown)
    path = out / "report.html"
    write_atomic(
        path, page_html(page, together, field_data(together.messages, str(INSIDE_MB), out))
    )
    return path
