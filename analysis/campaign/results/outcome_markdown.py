"""Render a campaign's outcomes as a Markdown table, for the step summary of a CI."""

from collections.abc import Sequence

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CellResult
from analysis.campaign.results.outcome_grid import GridCell, outcome_grid


def render_markdown(campaign: CampaignFile, results: Sequence[CellResult]) -> str:
    """Return a table with one row per subject and fault, and one cell per magnitude."""
    rows = outcome_grid(results, campaign)
    # Markdown needs rows of equal length.
    width = max((len(row.cells) for row in rows), default=0)
    lines = [
        f"### {campaign.name}: {len(results)} cells",
        "",
        "| subject | fault |" + " |" * width,
        "|---|---|" + "---|" * width,
    ]
    for row in rows:
        cells = [_text(cell) for cell in row.cells] + [""] * (width - len(row.cells))
        lines.append("| " + " | ".join((row.subject, row.fault, *cells)) + " |")
    return "\n".join(lines) + "\n"


def _text(cell: GridCell) -> str:
    name = "" if cell.magnitude is None else f"{cell.magnitude:.4g} "
    return name + cell.worst.outcome
