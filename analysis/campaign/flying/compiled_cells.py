"""Fly cells by compiled flights, which go to the estimator without frames and proxy.

They record no curves: the excursion is the largest error of the entire flight minus that of the
reference flight. Cells of a scenario and seed share the simulated flight; only faults differ.
"""

import time
from collections.abc import Sequence

import msgspec

from analysis.campaign.campaign_file import CampaignFile, CompiledScenario
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.outcomes import outcome_of
from analysis.search.evaluation.compiled_flight import sampled_flight
from analysis.search.evaluation.compiled_score import estimate_flight, score_estimated
from analysis.search.evaluation.envelope import LIMITS
from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.space.point_scenario import document_of
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.errors import ConfigError

ANGLE_COLUMN = 3  # column of the total angle in the errors


def run_compiled(campaign: CampaignFile, cells: Sequence[Cell]) -> list[CellResult]:
    """Return the outcomes of cells that share subject, scenario, fault and seed.

    Raises
    ------
    ConfigError
        If compiled flights do not have the fault.
    """
    test = compiled_test_file(campaign, cells[0])
    healthy = {name: float(value) for name, value in Evaluator(test).space.fixed.items()}
    # A fault of no duration is absent.
    absent, seed = healthy | {"faults[0].for_s": 0.0}, cells[0].seed
    flight = sampled_flight(test, document_of(test, absent, seed))
    reference = score_estimated(test, estimate_flight(test, flight, absent, seed))
    results = []
    for cell in cells:
        started_s = time.monotonic()
        values = healthy | {"faults[0].at_s": float(cell.onset), "faults[0].for_s": cell.duration_s}
        if cell.magnitude is not None:
            values["faults[0].value"] = cell.magnitude
        scores = score_estimated(test, estimate_flight(test, flight, values, seed))
        beyond_deg = float(scores.largest_deg[ANGLE_COLUMN] - reference.largest_deg[ANGLE_COLUMN])
        limit = LIMITS[scores.broken_limit]
        results.append(
            CellResult(
                cell=cell,
                outcome=outcome_of(
                    beyond_deg, 0.0, {"crashed"} if limit else set(), campaign.limits
                ),
                onset_s=float(cell.onset),
                excursion_deg=beyond_deg,
                note=f"left the envelope: {limit}" if limit else "",
                wall_s=time.monotonic() - started_s,
            )
        )
    return results


def compiled_test_file(campaign: CampaignFile, cell: Cell) -> TestFile:
    """Build the search's test file for cells like this one."""
    scenario = next(
        s for s in campaign.scenarios if isinstance(s, CompiledScenario) and s.name == cell.scenario
    )
    fault = campaign.all_faults[cell.fault]
    target = fault.target if isinstance(fault.target, str) else None
    entry = {"fault": fault.fault, "target": target, "at_s": 0.0, "for_s": 1.0, "also": fault.also}
    if cell.magnitude is not None:
        entry["value"] = 0.0
    document = {
        **scenario.compiled,
        "estimator": cell.subject,
        "criterion": "angle",
        "faults": [entry],
    }
    try:
        return msgspec.convert(document, TestFile)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{campaign.name}: {cell.scenario}, {cell.fault}: {error}") from None
