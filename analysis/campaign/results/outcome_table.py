"""Print a campaign's outcomes to the terminal."""

from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.results.outcome_grid import GridCell, outcome_grid
from analysis.campaign.results_store import read_campaign_folder

COLOURS = {
    "unaffected": "green", "detected": "cyan", "degraded": "yellow", "failsafe": "magenta",
    "landed": "magenta", "lost": "red", "crashed": "bold red", "aborted": "dim",
}  # fmt: skip


def print_outcomes(folder: Path, plan: CampaignPlan) -> None:
    """Print one row per subject and fault, then critical magnitudes and aborted cells."""
    _, results = read_campaign_folder(folder)
    console = Console(markup=False)
    table = Table(box=None, pad_edge=False)
    for name in ("subject", "fault", "worst outcome from each magnitude"):
        table.add_column(name)
    for row in outcome_grid(results, plan.campaign):
        # Only the magnitudes at which the outcome changes.
        steps = [next(group) for _, group in groupby(row.cells, lambda c: c.worst.outcome)]
        table.add_row(row.subject, row.fault, Text("  ").join(map(_text, steps)))
    console.print(table)
    if plan.campaign.find == "critical":
        console.print(_criticals(plan, {result.cell.key: result for result in results}))
    aborted = [result for result in results if result.outcome == "aborted"]
    # Five are enough to see the reason; the files have all.
    for result in aborted[:5]:
        console.print(f"aborted: {result.cell.key}: {result.note}", soft_wrap=True)
    console.print(f"{len(results)} cells, {len(aborted)} aborted")
    console.print(f"page     {folder / 'campaign.html'}", soft_wrap=True)


def _text(cell: GridCell) -> Text:
    name = "" if cell.magnitude is None else f"{cell.magnitude:.4g} "
    outcome = cell.worst.outcome
    count = cell.outcomes[outcome]
    # A share only if the cell has several flights.
    share = f" {count}/{len(cell.results)}" if len(cell.results) > 1 else ""
    return Text.assemble(name, (f"{outcome}{share}", COLOURS[outcome]))


def _criticals(plan: CampaignPlan, known: dict[str, object]) -> Table:
    table = Table(box=None, pad_edge=False, title="critical magnitudes")
    for name in ("subject", "scenario", "fault", "onset", "for s", "seed", "magnitude", "flights"):
        table.add_column(name)
    for series, critical in plan.critical_magnitudes(known).items():  # type: ignore[arg-type]
        text = "none" if critical.magnitude is None else f"{critical.magnitude:.4g}"
        table.add_row(*series, text, str(critical.flights))
    return table
