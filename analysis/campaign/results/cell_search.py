"""Convert a cell of a campaign to a test file that searches for the worst case around it."""

import os
from pathlib import Path
from typing import Any

from analysis.campaign.campaign_file import MAGNITUDE, CampaignFile, CompiledScenario
from analysis.campaign.cell import CellResult, file_key
from analysis.campaign.results.campaign_report import name_tests
from analysis.campaign.results.outcome_grid import severity_key
from analysis.campaign.results_store import read_campaign_folder
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import write_yaml

MAGNITUDE_FACTOR = 3.0  # chosen: search from a third of the cell's magnitude to three times as much


def write_search(folder: Path, key: str | None) -> Path:
    """Write the test file of a cell (None: the worst) to the campaign's folder; return its path.

    Raises
    ------
    ConfigError
        If the cell does not exist, or a search cannot vary its fault.
    """
    campaign, results = read_campaign_folder(folder)
    cells = {result.cell.key: result for result in results}
    # A JUnit name may stand for several subjects: the worst of them counts, which comes last.
    results.sort(key=severity_key)
    cells |= dict(zip(name_tests(campaign, results), results, strict=True))
    if key is not None and key not in cells:
        known = next(iter(cells), "none at all")
        raise ConfigError(
            f"{key}: not a cell of {folder}; give a JUnit name or a key, such as {known}"
        )
    result = results[-1] if key is None else cells[key]
    path = folder / f"search-{file_key(*result.cell.key.split('|'))}.yaml"
    path.write_text(write_yaml(search_test_file(campaign, result, folder)))
    return path


def search_test_file(campaign: CampaignFile, result: CellResult, folder: Path) -> dict[str, Any]:
    """Build the test file around a cell: magnitude, onset and duration become ranges."""
    cell = result.cell
    fault = campaign.all_faults[cell.fault]
    if fault.preset is not None or fault.sets != MAGNITUDE or not isinstance(fault.target, str):
        raise ConfigError(
            f"{cell.fault}: a search can only vary the value of a fault on one target"
        )
    entry: dict[str, Any] = {"fault": fault.fault, "target": fault.target}
    if cell.magnitude is not None:
        # Sorted, since a negative magnitude reverses the interval.
        ends = (cell.magnitude / MAGNITUDE_FACTOR, cell.magnitude * MAGNITUDE_FACTOR)
        entry["value"] = sorted(float(f"{end:.4g}") for end in ends)
    onset_s, lasts_s = result.onset_s, cell.duration_s
    entry["at_s"] = [max(0.0, onset_s - lasts_s), onset_s + lasts_s]
    entry["for_s"] = [lasts_s / 2.0, lasts_s * 2.0]
    if fault.also:
        entry["also"] = fault.also
    return {
        **_flight(campaign, cell.scenario, folder),
        **_subject(campaign, result),
        "seed": cell.seed,
        "faults": [entry],
    }


def _flight(campaign: CampaignFile, name: str, folder: Path) -> dict[str, Any]:
    """Return the scenario keys: those of a compiled scenario, or a file with its varied values."""
    for scenario in campaign.scenarios:
        if isinstance(scenario, CompiledScenario) and scenario.name == name:
            return dict(scenario.compiled)
    file, *changes = campaign.scenario_arguments(name)
    # An interval of length zero keeps a value fixed.
    fixed = {path: float(value) for path, _, value in (c.partition("=") for c in changes[1::2])}
    vary = {path: [value, value] for path, value in fixed.items()}
    return {"scenario": os.path.relpath(file, folder), "vary": vary}


def _subject(campaign: CampaignFile, result: CellResult) -> dict[str, Any]:
    """Return the subject keys: an estimator, or an autopilot as `run` starts it, with the
    requirement that the cell violated."""
    name = result.cell.subject
    autopilot = campaign.autopilot(name)
    if autopilot is None:
        return {"estimator": name, "criterion": "angle"}
    if autopilot.arguments:
        raise ConfigError(f"{name}: a search does not support `arguments` of an autopilot")
    choice = {"kind": autopilot.autopilot, "binary": autopilot.binary}
    if autopilot.parameters:
        parameters = Path(campaign.folder) / autopilot.parameters
        choice["parameters"] = str(parameters.resolve())
    violated = [one.formula for one in result.requirements if one.met is False]
    required = (violated or ["knows_its_attitude"])[0]
    return {"estimator": "autopilot", "autopilot": choice, "violate": required}
