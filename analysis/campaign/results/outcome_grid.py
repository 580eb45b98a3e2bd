"""Results as a grid: a row for each subject and fault, a column for each magnitude.

Cells of a row and column differ in scenario, onset, duration and seed; the worst of them stands
for all, with how many there are of each outcome.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import outcome_rank


class GridCell(NamedTuple):
    """Results of one magnitude of a fault; the worst first."""

    magnitude: float | None
    results: tuple[CellResult, ...]

    @property
    def worst(self) -> CellResult:
        """What stands for all."""
        return self.results[0]

    @property
    def outcomes(self) -> Counter[str]:
        """How many there are of each outcome."""
        return Counter(result.outcome for result in self.results)


class GridRow(NamedTuple):
    """A subject and a fault, its cells by magnitude."""

    subject: str
    fault: str
    cells: tuple[GridCell, ...]


def outcome_grid(results: Sequence[CellResult], campaign: CampaignFile) -> list[GridRow]:
    """The rows in the order of the file."""
    found: dict[tuple[str, str], dict[float | None, list[CellResult]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for result in results:
        cell = result.cell
        found[cell.subject, cell.fault][cell.magnitude].append(result)
    return [
        # A fault without a magnitude has one column.
        GridRow(*names, tuple(_cell(m, by[m]) for m in sorted(by, key=lambda m: m or 0.0)))
        for names in product(campaign.subject_names, [fault.name for fault in campaign.faults])
        if (by := found.get(names))
    ]


def _cell(magnitude: float | None, results: list[CellResult]) -> GridCell:
    return GridCell(magnitude, tuple(sorted(results, key=severity_key, reverse=True)))


def severity_key(result: CellResult) -> tuple[int, float]:
    """Orders results: by outcome, then by how far the errors went."""
    # Degrees and metres added: only to order results of the same outcome.
    return outcome_rank(result.outcome), (result.excursion_deg or 0.0) + (result.excursion_m or 0.0)


def failsafe_share(results: Sequence[CellResult]) -> float | None:
    """Of an autopilot's bad flights, the share in which a failsafe acted; None for an estimator."""
    # From the rank of a failsafe on: nothing milder calls for one.
    bad = [r for r in results if outcome_rank(r.outcome) >= outcome_rank("failsafe")]
    # An estimator alone neither lands nor crashes, and has no failsafe.
    flown = any(r.failsafe or r.outcome in ("landed", "crashed") for r in bad)
    return sum(bool(r.failsafe) for r in bad) / len(bad) if flown else None
