"""A campaign's outcomes on the terminal, and as Markdown for the step summary of a CI."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.table import Table
from rich.text import Text

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import CellResult
from analysis.campaign.magnitude_unit import MagnitudeUnit, magnitude_units
from analysis.campaign.outcomes import ABORTED
from analysis.campaign.results.outcome_grid import (
    GridCell,
    find_interactions,
    outcome_grid,
    requirement_counts,
)
from analysis.campaign.results.subject_scores import conditions_hash, score_subjects
from analysis.campaign.results_store import read_campaign_folder
from mavproxy_fault.app.command_result import open_console, plain_table

COLOURS = {
    "unaffected": "green", "detected": "cyan", "degraded": "yellow", "failsafe": "magenta",
    "landed uncommanded": "magenta", "lost": "red", "flew away": "red", "lost control": "red",
    "crashed": "bold red", "aborted": "dim",
}  # fmt: skip


def print_outcomes(folder: Path, plan: CampaignPlan) -> None:
    """Print one row per subject and fault, then critical magnitudes and aborted cells."""
    campaign, results = read_campaign_folder(folder)
    units = magnitude_units(campaign)
    console = open_console()
    table = plain_table("subject", "fault", "worst outcome from each magnitude")
    for row in outcome_grid(results, plan.campaign):
        # Only the magnitudes at which the outcome changes.
        steps = [next(group) for _, group in groupby(row.cells, lambda c: c.worst.outcome)]
        table.add_row(
            row.subject, row.fault, Text("  ").join(_text(c, units[row.fault]) for c in steps)
        )
    console.print(table)
    if plan.campaign.find == "critical":
        console.print(_criticals(plan, {result.cell.key: result for result in results}, units))
    for name, counts in requirement_counts(results).items():
        total = sum(counts[word] for word in ("satisfied", "violated", "not shown"))  # type: ignore[misc]
        console.print(
            f"requirement {name}: violated in {counts['violated']} of {total} cells; worst: "
            f"{counts['worst']} in {counts['cell']}",
            soft_wrap=True,
        )
    for result in find_interactions(campaign, results):
        console.print(f"fails only as a pair: {result.cell.key}: {result.outcome}", soft_wrap=True)
    aborted = [result for result in results if result.outcome == ABORTED]
    # Five are enough to see the reason; the files have all.
    for result in aborted[:5]:
        console.print(f"aborted: {result.cell.key}: {result.note}", soft_wrap=True)
    failed = sum(campaign.fails(result) for result in results)
    rule = campaign.fail_from if campaign.fail_from == ABORTED else f"{campaign.fail_from} or worse"
    console.print(f"{len(results)} cells, {len(aborted)} aborted, {failed} failed ({rule})")
    for score in score_subjects(campaign, results):
        console.print(score.describe(), soft_wrap=True)
    console.print(f"sha256   {conditions_hash(campaign)} of all conditions", soft_wrap=True)
    console.print(f"page     {folder / 'campaign.html'}", soft_wrap=True)


def render_markdown(campaign: CampaignFile, results: Sequence[CellResult]) -> str:
    """Return a table with one row per subject and fault, and one cell per magnitude."""
    rows, units = outcome_grid(results, campaign), magnitude_units(campaign)
    failed = sum(campaign.fails(result) for result in results)
    # Markdown needs rows of equal length.
    width = max((len(row.cells) for row in rows), default=0)
    lines = [
        f"### {campaign.name}: {len(results)} cells, {failed} failed",
        "",
        "| subject | fault |" + " |" * width,
        "|---|---|" + "---|" * width,
    ]
    for row in rows:
        cells = [f"{units[row.fault].describe(one.magnitude)} {one.worst.outcome}".lstrip()
                 for one in row.cells]  # fmt: skip
        cells += [""] * (width - len(row.cells))
        lines.append("| " + " | ".join((row.subject, row.fault, *cells)) + " |")
    return "\n".join(lines) + "\n"


def _text(cell: GridCell, unit: MagnitudeUnit) -> Text:
    name = f"{unit.describe(cell.magnitude)} ".lstrip()
    outcome = cell.worst.outcome
    count = cell.outcomes[outcome]
    # A share only if the cell has several flights.
    share = f" {count}/{len(cell.results)}" if len(cell.results) > 1 else ""
    return Text.assemble(name, (f"{outcome}{share}", COLOURS[outcome]))


def _criticals(
    plan: CampaignPlan, known: dict[str, object], units: dict[str, MagnitudeUnit]
) -> Table:
    table = plain_table(
        "subject",
        "scenario",
        "fault",
        "onset",
        "duration, s",
        "seed",
        "critical magnitude",
        "flights",
    )
    for series, critical in plan.critical_magnitudes(known).items():  # type: ignore[arg-type]
        text = units[series[2]].describe(critical.magnitude) or "none"
        table.add_row(*series, text, str(critical.flights))
    return table
