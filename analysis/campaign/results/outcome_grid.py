"""Arrange results as a grid: a row for each subject and fault, a column for each magnitude.

Flights of one grid cell differ in scenario, onset, duration and seed; the grid cell shows the worst
outcome and the number of each outcome.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import outcome_rank
from analysis.scoring.vehicle_outcome import CRASHED, FLEW_AWAY, LOST_CONTROL, UNCOMMANDED

OF_VEHICLES = frozenset((UNCOMMANDED, FLEW_AWAY, LOST_CONTROL, CRASHED))


class GridCell(NamedTuple):
    """Results of one magnitude of a fault, worst first."""

    magnitude: float | None
    results: tuple[CellResult, ...]

    @property
    def worst(self) -> CellResult:
        """The worst result, which the grid cell shows."""
        return self.results[0]

    @property
    def outcomes(self) -> Counter[str]:
        """The number of each outcome."""
        return Counter(result.outcome for result in self.results)


class GridRow(NamedTuple):
    """The cells of a subject and a fault by magnitude."""

    subject: str
    fault: str
    cells: tuple[GridCell, ...]


def outcome_grid(results: Sequence[CellResult], campaign: CampaignFile) -> list[GridRow]:
    """Return the rows in the order of the campaign file."""
    groups: dict[tuple[str, str], dict[float | None, list[CellResult]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for result in results:
        cell = result.cell
        groups[cell.subject, cell.fault][cell.magnitude].append(result)
    return [
        # A fault without a magnitude has one column.
        GridRow(*names, tuple(_cell(m, cells[m]) for m in sorted(cells, key=lambda m: m or 0.0)))
        for names in product(campaign.subject_names, campaign.all_faults)
        if (cells := groups.get(names))
    ]


def _cell(magnitude: float | None, results: list[CellResult]) -> GridCell:
    return GridCell(magnitude, tuple(sorted(results, key=severity_key, reverse=True)))


def severity_key(result: CellResult) -> tuple[int, float]:
    """Return a sort key: outcome first, then the size of the excursions."""
    # Degrees plus metres is enough to order results of the same outcome.
    return outcome_rank(result.outcome), (result.excursion_deg or 0.0) + (result.excursion_m or 0.0)


def requirement_counts(results: Sequence[CellResult]) -> dict[str, dict[str, object]]:
    """Return, by requirement, the number of cells that met, violated or did not show it, and its
    worst robustness with the key of the cell."""
    found: dict[str, dict[str, object]] = {}
    judged = [(one, result.cell.key) for result in results for one in result.requirements]
    for name in dict.fromkeys(one.name for one, _ in judged):
        rows = [(one, key) for one, key in judged if one.name == name]
        worst, key = min(rows, key=lambda row: row[0].fitness)
        counts = Counter(one.met for one, _ in rows)
        found[name] = {
            "satisfied": counts[True], "violated": counts[False], "not shown": counts[None],
            "worst": worst.describe(), "cell": key,
        }  # fmt: skip
    return found


def find_interactions(campaign: CampaignFile, results: Sequence[CellResult]) -> list[CellResult]:
    """Return the failed pairs of faults of which neither failed alone in the same conditions."""
    known = {result.cell.key: result for result in results}
    found = []
    for result in results:
        parts = campaign.all_faults[result.cell.fault].faults
        if result.cell.fault not in campaign.pair_names:
            continue
        alone = [
            known.get(msgspec.structs.replace(
                result.cell, fault=part.name, magnitude=part.magnitude_list()[0]).key)
            for part in parts
        ]  # fmt: skip
        if campaign.fails(result) and all(one and not campaign.fails(one) for one in alone):
            found.append(result)
    return found


def failsafe_share(results: Sequence[CellResult]) -> float | None:
    """Return the share of an autopilot's bad flights with a failsafe; None for an estimator."""
    # Bad flights are failsafe or worse: a milder outcome needs no failsafe.
    bad = [r for r in results if outcome_rank(r.outcome) >= outcome_rank("failsafe")]
    # An estimator neither lands nor crashes, and has no failsafe.
    has_autopilot = any(r.failsafe or r.outcome in OF_VEHICLES for r in bad)
    return sum(bool(r.failsafe) for r in bad) / len(bad) if has_autopilot else None
