"""Fly the scenario of a point with its faults, in the simulator or with an autopilot."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from analysis.flying.autopilot_cell import run_autopilot_cell
from analysis.flying.flight_evidence import CampaignFlight
from analysis.flying.internal_flight import run_simulated_flight
from analysis.run.run_setup import read_setup
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.yaml_document import without_none, write_yaml
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.vehicles.body import Truth


def fly_point(
    test: TestFile,
    document: Mapping[str, Any],
    keep: Path | None = None,
    stop: Callable[[Truth], bool] | None = None,
) -> CampaignFlight:
    """Fly the scenario of a point; `keep` is the folder for the logs, a truth may `stop` the
    simulator.

    Raises
    ------
    ConfigError
        If the flight fails, or a value is not allowed.
    """
    schedule = schedule_of(document)
    with tempfile.TemporaryDirectory(prefix="search-") as scratch:
        folder = keep or Path(scratch)
        file = write_scenario(document, folder)
        if test.autopilot is not None:
            run = [file, *test.autopilot.options()]
            return run_autopilot_cell(
                test.estimator, run, schedule, folder, kept=False, must_act=False
            )
        setup = replace(read_setup(file), schedule=parse_schedule(schedule, "the search"))
        return run_simulated_flight(setup, [test.estimator], keep, stop)


def write_scenario(document: Mapping[str, Any], folder: Path) -> str:
    """Write the scenario of a point without its schedule to a folder; return the file's path."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "scenario.yaml"
    scenario = {key: value for key, value in document.items() if key != "schedule"}
    file.write_text(write_yaml(without_none(scenario)))
    return str(file)


def schedule_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """The schedule of a point's faults."""
    return {"seed": document["seed"], "faults": document["schedule"]["faults"]}
