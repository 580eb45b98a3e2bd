"""Render a campaign's outcomes as a Markdown table, for the step summary of a CI."""

from collections.abc import Sequence

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CellResult
from analysis.campaign.magnitude_unit import MagnitudeUnit, magnitude_units
from analysis.campaign.results.outcome_grid import GridCell, outcome_grid


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
        cells = [_text(cell, units[row.fault]) for cell in row.cells]
        cells += [""] * (width - len(row.cells))
        lines.append("| " + " | ".join((row.subject, row.fault, *cells)) + " |")
    return "\n".join(lines) + "\n"


def _text(cell: GridCell, unit: MagnitudeUnit) -> str:
    return f"{unit.describe(cell.magnitude)} {cell.worst.outcome}".lstrip()
