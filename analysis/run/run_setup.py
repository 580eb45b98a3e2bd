"""Read a scenario file and decode its sections for simulator, proxy and monitor."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from analysis.estimators import estimator_names
from analysis.monitor.pipeline import MonitorConfig, monitor_config
from analysis.run.vehicle_effects import vehicle_effects
from analysis.run.vehicle_parts import check_parts
from analysis.scoring.criteria import Criteria
from analysis.scoring.requirements import Requirement, read_requirements
from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import Document, Lines
from mavproxy_fault.documents.yaml_document import Path as DocumentPath
from mavproxy_fault.schedule.entries import Schedule, parse_schedule, read_schedule
from simvehicle.scenario.changed_scenario import change_scenario, parse_change
from simvehicle.scenario.scenario_file import Scenario, decode_scenario, open_scenario
from simvehicle.sensors.magnetometer import Magnetometer
from simvehicle.simulation.simulation import Simulation
from simvehicle.simulation.vehicle_kinds import find_vehicle_kind


@dataclass(frozen=True, slots=True)
class RunSetup:
    """The settings of a run; `scenario.seed` seeds both the simulator and the faults."""

    scenario: Scenario
    schedule: Schedule
    monitor: MonitorConfig
    criteria: Criteria
    requirements: tuple[Requirement, ...] = ()


def read_setup(
    path: str | None,
    schedule: str | None = None,
    seed: int | None = None,
    changes: Mapping[str, Any] | None = None,
    estimators: Sequence[str] | None = None,
    required: Sequence[str] = (),
    flown: bool = True,
) -> RunSetup:
    """Read a scenario (None: the demo), and replace its schedule, seed or values if given.

    `changes` are values of the scenario by their paths, as in `changed_scenario`; `estimators`
    replace the attitude estimators that the scenario names; `required` are further requirements.
    The monitor of a setup that is not `flown` does not learn how the vehicle responds.

    Raises
    ------
    ConfigError
        If a section is wrong; nothing has been started yet.
    """
    document = open_scenario(path)
    scenario = change_scenario(decode_scenario(document), changes or {})
    if seed is not None:
        if seed < 0:
            raise ConfigError(f"--seed: {seed} is negative; it must be 0 or more")
        scenario = msgspec.structs.replace(scenario, seed=seed)
    # Check the vehicle's parameters before anything starts.
    find_vehicle_kind(scenario.vehicle.kind).read(scenario.vehicle.parameters)
    faults = read_schedule(schedule) if schedule is not None else _schedule(scenario, document)
    check_parts(faults.faults, lambda: Simulation(scenario))
    criteria = Criteria()
    if scenario.criteria is not None:
        criteria = decode(document, Criteria, ("criteria",))
    if schedule is not None:
        criteria = _criteria_for(criteria, faults)
    monitor = monitor_config(scenario.monitor, document.where, document.lines)
    if estimators is not None:
        attitude = msgspec.structs.replace(monitor.attitude, estimators=tuple(estimators))
        monitor = msgspec.structs.replace(monitor, attitude=attitude)
    if flown:
        monitor = msgspec.structs.replace(
            monitor, actuators=vehicle_effects(scenario), field_ned_gauss=_field_ned_gauss(scenario)
        )
    requirements = read_requirements(f"{document.where}: requirements", scenario.requirements)
    requirements += read_requirements("--require", list(required))
    # One of both places is judged once.
    named = {one.label: one for one in requirements}
    return RunSetup(scenario, faults, monitor, criteria, tuple(named.values()))


def setup_from_args(args: argparse.Namespace) -> RunSetup:
    """Read the settings from the command line of `run`; errors as in `read_setup`."""
    changes = dict(map(parse_change, args.set))
    estimators = args.estimators and [name.strip() for name in args.estimators.split(",")]
    for name in estimators or ():
        if name not in (known := estimator_names()):
            raise ConfigError(f"--estimators: {name} is unknown; {suggest_known(name, known)}")
    return read_setup(args.scenario, args.schedule, args.seed, changes, estimators, args.require)


def _field_ned_gauss(scenario: Scenario) -> tuple[float, float, float] | None:
    """Return the magnetic field that a scenario sets; None for the Earth's field."""
    mag = scenario.sensors.mag
    first = mag[0] if isinstance(mag, list) and mag else mag
    return first.field_ned_gauss if isinstance(first, Magnetometer) else None


def _criteria_for(criteria: Criteria, faults: Schedule) -> Criteria:
    """Remove requirements on faults that another schedule does not contain."""
    ids = {entry.id for entry in faults.faults}
    requirements = {
        name: tuple(id for id in getattr(criteria, name) if id in ids)
        for name in ("must_detect", "must_isolate")
    }
    return msgspec.structs.replace(criteria, **requirements)


def _schedule(scenario: Scenario, document: Document) -> Schedule:
    """Read the schedule file that a scenario names, or its own schedule section."""
    section = scenario.schedule
    if isinstance(section, str):
        return read_schedule(Path(document.where).parent / section)
    # A list holds only the faults, a mapping the complete schedule.
    data = section if isinstance(section, dict) else {"faults": section or []}
    # Error messages need line numbers of the scenario file.
    lines = _below(document.lines, () if isinstance(section, dict) else ("faults",))
    return parse_schedule(Document({"seed": scenario.seed, **data}, document.where, lines))


def _below(lines: Lines, head: DocumentPath) -> Lines:
    """Return line numbers of the section `schedule`, by paths within the schedule."""
    return {(*head, *at[1:]): line for at, line in lines.items() if at[:1] == ("schedule",)}
