"""Fly cells with the compiled kernels of the search, thousands at once.

The kernels record no curves: the excursion is the largest error of the entire flight minus that of
the reference flight, which is part of the same batch and has the same noise.
"""

import time
from collections.abc import Sequence

import msgspec
import numpy as np

from analysis.campaign.campaign_file import CampaignFile, CompiledScenario
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.outcomes import outcome_of
from analysis.search.evaluation.compiled_batch import Batch
from analysis.search.lanes import rows
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.errors import ConfigError

NEVER_S = 1e9  # onset of the reference flight, after the end of every flight
ANGLE_COLUMN = 3  # column of the total angle in the errors


def run_lanes(campaign: CampaignFile, cells: Sequence[Cell]) -> list[CellResult]:
    """Return the outcomes of cells that share subject, scenario, fault and seed.

    Raises
    ------
    ConfigError
        If the kernels do not support the fault or the subject.
    """
    started_s = time.monotonic()
    batch = Batch(lane_test_file(campaign, cells[0]))
    # The reference flight first: its fault never begins.
    at_s = [NEVER_S, *(float(cell.onset) for cell in cells)]
    count = len(at_s)
    values = {name: np.full(count, value) for name, value in batch.space.fixed.items()}
    values["faults[0].at_s"] = np.array(at_s)
    values["faults[0].for_s"] = np.array([1.0, *(cell.duration_s for cell in cells)])
    if cells[0].magnitude is not None:
        values["faults[0].value"] = np.array([0.0, *(cell.magnitude for cell in cells)], float)
    # With the same noise in every lane, only the fault makes a difference to the reference flight.
    outcome = batch.evaluate_values(values, cells[0].seed, 0, 1, same_noise=True)
    largest_deg = outcome.largest_deg[:, ANGLE_COLUMN]
    excursion_deg = largest_deg[1:] - largest_deg[0]
    # Every cell gets an equal share of the batch's time.
    wall_s = (time.monotonic() - started_s) / len(cells)
    results = []
    for cell, beyond, limit in zip(cells, excursion_deg, outcome.broken_limit[1:], strict=True):
        kinds = {"crashed"} if limit > 0 else set()
        results.append(
            CellResult(
                cell=cell,
                outcome=outcome_of(float(beyond), 0.0, kinds, campaign.limits),
                onset_s=float(cell.onset),
                excursion_deg=float(beyond),
                note=f"left the envelope: {rows.LIMITS[limit]}" if limit > 0 else "",
                wall_s=wall_s,
            )
        )
    return results


def lane_test_file(campaign: CampaignFile, cell: Cell) -> TestFile:
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
