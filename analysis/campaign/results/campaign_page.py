"""The HTML page of a campaign: heat map, reaction times, worst cells, and curves, in one file.

The page needs no network. Names come from the campaign file and are escaped.
"""

import json
import shlex
from collections import Counter
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from statistics import median

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import CellResult
from analysis.campaign.magnitude_unit import MagnitudeUnit, magnitude_units
from analysis.campaign.outcomes import RANKS, OutcomeLimits, outcome_rank
from analysis.campaign.results.outcome_grid import (
    GridCell,
    GridRow,
    failsafe_share,
    outcome_grid,
    severity_key,
)
from analysis.campaign.results_store import CellEvidence
from analysis.estimators import estimator_names
from analysis.flying.flight_evidence import Evidence, EvidenceCurve
from analysis.flying.onset import onset_keys
from analysis.report.page.page_body import read_asset, table_html
from analysis.report.page.page_file import embedded_json, html_document
from analysis.report.page.page_parts import ReportTable
from analysis.scoring.requirements import parse_requirements, requirement_arguments

MAX_LISTED = 5000  # results in the page, the worst ones
MAX_CURVE_POINTS = 200  # of one curve
WORST_ROWS = 12  # of the table of the worst cells
MAX_PARETO_ROWS = 20


def render_campaign_page(
    plan: CampaignPlan,
    results: Sequence[CellResult],
    curves: Sequence[CellEvidence],
    references: dict[str, Evidence],
    reload_s: float | None = None,
) -> str:
    """Return the HTML; `references`: evidence of reference flights by `subject|scenario|seed`.

    With `reload_s` the campaign is running: the page shows its progress and reloads itself.
    """
    # Only the worst: compiled campaigns have more results than a browser can hold.
    listed = sorted(results, key=severity_key, reverse=True)[:MAX_LISTED]
    numbers = {result.cell.key: number for number, result in enumerate(listed)}
    grid, units = outcome_grid(results, plan.campaign), magnitude_units(plan.campaign)
    model = {
        "reload_s": reload_s,
        "ranks": RANKS,
        "limits": msgspec.to_builtins(plan.campaign.limits),
        "rows": [_row(row, numbers, units[row.fault]) for row in grid],
        "results": [_result_model(result, plan.campaign) for result in listed],
        # Curves of the listed results only.
        "curves": {
            numbers[item.key]: _curves(item.evidence) for item in curves if item.key in numbers
        },
        "twins": {key: _curves(evidence) for key, evidence in references.items()},
    }
    # Style and plots are shared with the reports.
    own = files("analysis.campaign.results") / "assets"
    style = read_asset("uPlot.min.css") + read_asset("page.css")
    body = "".join(
        (
            f"<header><h1>{escape(plan.campaign.name)}</h1></header><main>",
            "" if reload_s is None else _progress_html(len(results), plan.max_cells),
            _facts_html(results),
            '<p class="note">Each cell is one magnitude of a fault and shows the worst outcome of '
            "its flights. Hover for numbers, click for the flights and their curves.</p>",
            '<div id="legend"></div><div id="map"></div><div id="detail"></div>',
            _reactions_html(grid),
            _pareto_html(grid, plan.campaign.limits),
            _worst_html(listed[:WORST_ROWS], units),
            f'</main><script type="application/json" id="model">{embedded_json(model)}</script>',
            f"<!-- uPlot: {read_asset('uPlot.LICENSE')} -->",
        )
    )
    return html_document(
        plan.campaign.name,
        style + (own / "campaign.css").read_text(),
        body,
        read_asset("uPlot.iife.min.js") + "\n" + (own / "campaign.js").read_text(),
    )


def _row(row: GridRow, numbers: dict[str, int], unit: MagnitudeUnit) -> dict[str, object]:
    cells = [_cell(cell, numbers, unit) for cell in row.cells]
    return {"subject": row.subject, "fault": row.fault, "cells": cells}


def _cell(cell: GridCell, numbers: dict[str, int], unit: MagnitudeUnit) -> dict[str, object]:
    keys = (result.cell.key for result in cell.results)
    return {
        "magnitude": cell.magnitude,
        "size": unit.describe(cell.magnitude),
        "outcome": cell.worst.outcome,
        "counts": cell.outcomes,
        "results": [numbers[key] for key in keys if key in numbers],
    }


def _result_model(result: CellResult, campaign: CampaignFile) -> dict[str, object]:
    """Return the page's model of one result."""
    fields = msgspec.structs.asdict(result)
    cell = msgspec.structs.asdict(fields.pop("cell"))
    # Four digits for display; `cells.csv` has the full values.
    rounded = {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in fields.items()}
    judged = [f"{one.name}: {one.describe()}" for one in result.requirements]
    return {**cell, **rounded, "requirements": judged, "again": rerun_command(result, campaign)}


def rerun_command(result: CellResult, campaign: CampaignFile) -> str:
    """Return the command that repeats a cell with the live page; empty for a compiled one."""
    # A compiled cell has no scenario file for `run`.
    if campaign.compiled:
        return ""
    cell = result.cell
    start = onset_keys(cell.onset) or {"at_s": result.onset_s}
    entries = campaign.all_faults[cell.fault].entries(cell.magnitude, start, cell.duration_s)
    schedule = json.dumps({"seed": cell.seed, "faults": entries})
    autopilot = campaign.autopilot(cell.subject)
    arguments = ["mavproxy-fault", "run", *campaign.scenario_arguments(cell.scenario)]
    arguments += ["--schedule", "cell.yaml", "--seed", str(cell.seed)]
    if autopilot is not None:
        arguments += autopilot.options(campaign.folder)
    elif cell.subject in estimator_names():
        arguments += ["--estimators", cell.subject]
    arguments += [*requirement_arguments(parse_requirements(campaign.requirements)), "--ui"]
    return f"echo {shlex.quote(schedule)} > cell.yaml && {shlex.join(arguments)}"


def _curves(evidence: Evidence) -> dict[str, list[list[float]]]:
    """Return thinned times and values by name."""
    return {name: [*_thinned(curve)] for name, curve in evidence.curves.items()}


def _thinned(curve: EvidenceCurve) -> tuple[list[float], list[float]]:
    """Return times and the largest value of each section, so that no error peak is lost."""
    # Rounded up, so that no curve exceeds the maximum number of points.
    step = max(1, -(-len(curve.t_s) // MAX_CURVE_POINTS))
    starts = range(0, len(curve.t_s), step)
    return (
        [round(curve.t_s[i], 2) for i in starts],
        [round(max(curve.value[i : i + step]), 3) for i in starts],
    )


def _progress_html(completed: int, cells: int) -> str:
    """Return the progress bar of a running campaign."""
    return (
        f'<p role="status"><progress max="{cells}" value="{completed}" aria-label="Progress">'
        f"</progress> {completed} of {cells} cells completed; the page reloads itself.</p>"
    )


def _facts_html(results: Sequence[CellResult]) -> str:
    counts = Counter(result.outcome for result in results)
    facts = [(str(len(results)), "cells")]
    # In order of rank; aborted has none.
    facts += [(str(counts[name]), name) for name in (*RANKS, "aborted") if counts[name]]
    share = failsafe_share(results)
    if share is not None:
        facts.append((f"{100 * share:.0f} %", "of the failsafe-or-worse flights had a failsafe"))
    shown = "".join(f"<div><b>{value}</b><span>{name}</span></div>" for value, name in facts)
    return f'<div class="facts">{shown}</div>'


def _reactions_html(grid: Sequence[GridRow]) -> str:
    """Return the table of detection delays and recovery times by subject and fault."""
    rows = []
    for row in grid:
        row_results = [result for cell in row.cells for result in cell.results]
        delays = [r.detected_s for r in row_results if r.detected_s is not None]
        recoveries = [r.recovery_s for r in row_results if r.recovery_s is not None]
        # Only degraded or worse flights can recover.
        degraded = sum(outcome_rank(r.outcome) >= outcome_rank("degraded") for r in row_results)
        rows.append(
            (
                row.subject,
                row.fault,
                f"{len(delays)} of {len(row_results)}",
                f"{median(delays):.2f}" if delays else "",
                f"{len(recoveries)} of {degraded}",
                f"{median(recoveries):.2f}" if recoveries else "",
            )
        )
    head = ("subject", "fault", "detected", "median delay, s", "recovered", "median recovery, s")
    return "<h2>Reaction times</h2>" + table_html(ReportTable("Reaction times", head, rows))


def _pareto_html(grid: Sequence[GridRow], limits: OutcomeLimits) -> str:
    """Return the table of the faults with the most bad cells, and their cumulative share."""
    bad = {
        (row.subject, row.fault): sum(
            limits.is_worse(result.outcome) for cell in row.cells for result in cell.results
        )
        for row in grid
    }
    total, so_far = sum(bad.values()), 0
    rows = []
    for (subject, fault), count in sorted(bad.items(), key=lambda item: -item[1]):
        if count == 0:
            break
        so_far += count
        rows.append(
            (subject, fault, f"{count}", *(f"{100 * n / total:.0f}" for n in (count, so_far)))
        )
    head = ("subject", "fault", f"cells {limits.worse_from} or worse", "share, %", "cumulative, %")
    return "<h2>Most harmful faults (Pareto)</h2>" + table_html(
        ReportTable("Pareto", head, rows[:MAX_PARETO_ROWS])
    )


def _worst_html(results: Sequence[CellResult], units: dict[str, MagnitudeUnit]) -> str:
    rows = []
    for result in results:
        cell = result.cell
        rows.append(
            (
                result.outcome,
                cell.subject,
                cell.fault,
                units[cell.fault].describe(cell.magnitude),
                cell.onset if isinstance(cell.onset, str) else f"{cell.onset:g} s",
                "" if result.excursion_deg is None else f"{result.excursion_deg:.3g}",
                "" if result.excursion_m is None else f"{result.excursion_m:.3g}",
                result.note or result.detected_by,
                f"{result.verdict} {result.blamed}".strip(),
            )
        )
    head = (
        "outcome", "subject", "fault", "magnitude", "onset", "excursion, deg", "excursion, m",
        "note", "monitor",
    )  # fmt: skip
    return "<h2>Worst cells</h2>" + table_html(ReportTable("Worst cells", head, rows))
