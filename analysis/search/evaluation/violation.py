"""Fly a scenario with its faults, and judge the requirement that a search tries to violate."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from analysis.flying.autopilot_cell import run_autopilot_cell
from analysis.flying.flight_evidence import CampaignFlight
from analysis.flying.internal_flight import run_simulated_flight
from analysis.monitor.pipeline import monitor_config
from analysis.run.run_setup import RunSetup
from analysis.run.vehicle_effects import vehicle_effects
from analysis.scoring.criteria import Criteria
from analysis.scoring.requirements import RequirementResult
from analysis.search.evaluation.autopilot_flight import flight_arguments
from analysis.search.space.test_file import TestFile
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.scenario.scenario_file import Scenario


def fly_violation(
    test: TestFile, document: Mapping[str, Any], keep: Path | None = None
) -> tuple[RequirementResult, CampaignFlight]:
    """Fly the scenario of a point; `keep` is the folder for the logs.

    Raises
    ------
    ConfigError
        If the flight fails, or a value is not allowed.
    """
    requirement, schedule = test.requirement, dict(document["schedule"])
    schedule = {"seed": document["seed"], "faults": schedule["faults"]}
    if test.autopilot is not None:
        with tempfile.TemporaryDirectory(prefix="search-") as scratch:
            folder = keep or Path(scratch)
            arguments = flight_arguments(test.autopilot, document, folder)
            flight = run_autopilot_cell(
                test.estimator, arguments, schedule, folder, kept=False, must_act=False
            )
    else:
        scenario = msgspec.convert(
            {key: value for key, value in document.items() if value is not None}, Scenario
        )
        config = msgspec.structs.replace(
            monitor_config(document["monitor"], test.violate or "", {}),
            actuators=vehicle_effects(scenario),
        )
        setup = RunSetup(
            scenario, parse_schedule(schedule, "the search"), config, Criteria(), (requirement,)
        )
        flight = run_simulated_flight(setup, [test.estimator], keep)
    judged = {one.name: one for one in flight.requirements[test.estimator]}
    return judged[requirement.label], flight
