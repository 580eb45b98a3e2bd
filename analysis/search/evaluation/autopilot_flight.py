"""A flight with an autopilot: armed, from take-off to landing, by `run --autopilot`.

Its error is that of the autopilot's attitude in the air, less that of the fault-free reference
flight: root of the difference of the mean squares. The reference is flown once, with the same noise
for all tests.
"""

import json
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.autopilots.flight_process import repeat_flight_process
from analysis.results import AttitudeError, read_results
from analysis.scoring.attitude_scores import AXES
from analysis.scoring.attitude_scoring import AUTOPILOTS
from analysis.scoring.vehicle_outcome import BAD_ENDS
from analysis.search.space.test_file import AutopilotChoice
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import without_none, write_yaml

Array = NDArray[np.float64]
REFERENCE_SEED = 1


class AutopilotAttitude(NamedTuple):
    """Attitude errors of an autopilot in the air: mean squares (4,) in degrees squared, largest
    (4,) in degrees; duration of the flight, and why it ended early, if it did."""

    mean_square: Array
    largest_deg: Array
    lasted_s: float
    ended_early: str


def measure_autopilot_error(
    choice: AutopilotChoice, document: Mapping[str, Any], settle_s: float
) -> tuple[AutopilotAttitude, Array]:
    """Fly a scenario with its faults; returns its errors, and those due to the faults (4,) in
    degrees: roll, pitch, yaw, angle.

    Raises
    ------
    ConfigError
        If the autopilot does not fly it, or sends no attitude.
    """
    # One seed for all: each test has its own seed and would need its own reference.
    reference = {**document, "seed": REFERENCE_SEED, "schedule": {"faults": []}}
    base = _reference_flight(choice, json.dumps(reference, sort_keys=True), settle_s)
    errors = _fly(choice, document, settle_s)
    return errors, np.sqrt(np.maximum(errors.mean_square - base.mean_square, 0.0))


@cache
def _reference_flight(choice: AutopilotChoice, document: str, settle_s: float) -> AutopilotAttitude:
    """The fault-free reference flight, flown once for each scenario."""
    return _fly(choice, json.loads(document), settle_s)


def _fly(
    choice: AutopilotChoice, document: Mapping[str, Any], settle_s: float
) -> AutopilotAttitude:
    """Fly; return the autopilot's attitude errors."""
    with tempfile.TemporaryDirectory(prefix="search-") as scratch:
        folder = Path(scratch)
        arguments = flight_arguments(choice, document, folder)
        schedule = {"seed": document["seed"], "faults": document["schedule"]["faults"]}
        run, summary = repeat_flight_process("autopilot", arguments, schedule, folder, kept=False)
        return _read(run, summary, settle_s)


def flight_arguments(
    choice: AutopilotChoice, document: Mapping[str, Any], folder: Path
) -> list[str]:
    """Write the scenario of a point to a folder; return the arguments of `run` that fly it."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "scenario.yaml"
    scenario = {key: value for key, value in document.items() if key != "schedule"}
    file.write_text(write_yaml(without_none(scenario)))
    arguments = [str(file), "--autopilot", choice.kind]
    for option, value in (("--binary", choice.binary), ("--parameters", choice.parameters)):
        arguments += [option, value] if value is not None else []
    return arguments


def _read(run: Path, summary: Mapping[str, Any], settle_s: float) -> AutopilotAttitude:
    """The errors in a run folder, from `settle_s` after take-off to landing."""
    flight, outcome = summary["autopilot"], summary["outcome"]["outcome"]
    off_ground_s = flight["moments_s"]["take-off"]
    errors = [
        result
        for result in read_results(run / "results.jsonl")
        if isinstance(result, AttitudeError) and result.estimator in AUTOPILOTS
    ]
    until_s = flight["moments_s"].get("landing", np.inf)
    # ATTITUDE_QUATERNION sorts after ATTITUDE and is preferred where there are both.
    name = max((error.estimator for error in errors), default="")
    rows = np.array(
        [
            [getattr(error, axis) for axis in AXES]
            for error in errors
            if error.estimator == name and off_ground_s + settle_s <= error.t_us * 1e-6 < until_s
        ]
    )
    if not len(rows):
        raise ConfigError("autopilot: it sent no attitude in the air")
    last_s = errors[-1].t_us * 1e-6
    return AutopilotAttitude(
        np.mean(rows**2, axis=0),
        np.abs(rows).max(axis=0),
        min(last_s, until_s) - off_ground_s,
        # A vehicle that fell on its landing has "landed" too.
        outcome if outcome in BAD_ENDS else flight["ended_early"] * (not flight["landed"]),
    )
