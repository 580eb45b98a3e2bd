"""A scenario file, decoded for every part."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from analysis.monitor.pipeline import MonitorConfig, monitor_config
from analysis.scoring.criteria import Criteria
from mavproxy_fault.documents.checked import Lines, read_yaml
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import Schedule, parse_schedule, read_schedule
from simvehicle.scenario.scenario_file import Scenario, read_scenario
from simvehicle.simulation.kinds import kind_of


@dataclass(frozen=True, slots=True)
class Setup:
    """What a run needs; `scenario.seed` is the seed of simulator and faults alike."""

    scenario: Scenario
    schedule: Schedule
    monitor: MonitorConfig
    criteria: Criteria


def read_setup(path: str | None, schedule: str | None = None, seed: int | None = None) -> Setup:
    """Read a scenario (None: the demo), with another schedule or seed where given.

    Raises
    ------
    ConfigError
        If a section is wrong; nothing has been started then.
    """
    where = path or "the demo scenario"
    scenario = read_scenario(path)
    if seed is not None:
        if seed < 0:
            raise ConfigError(f"--seed: {seed} is negative; 0 or more is allowed")
        scenario = msgspec.structs.replace(scenario, seed=seed)
    kind_of(scenario.vehicle.kind).read(scenario.vehicle.parameters)
    faults = _schedule(scenario, path, schedule)
    try:
        criteria = msgspec.convert(scenario.criteria or {}, Criteria)
    except msgspec.ValidationError as error:
        known = ", ".join(field.name for field in msgspec.structs.fields(Criteria))
        raise ConfigError(f"{where}: criteria: {error}; known: {known}") from error
    if schedule is not None:
        criteria = _about(criteria, faults)
    return Setup(scenario, faults, monitor_config(scenario.monitor, where), criteria)


def _about(criteria: Criteria, faults: Schedule) -> Criteria:
    """What is asked of the scenario's own faults means nothing for those of another schedule."""
    ids = {entry.id for entry in faults.faults}
    asked = {
        name: tuple(id for id in getattr(criteria, name) if id in ids)
        for name in ("must_detect", "must_isolate")
    }
    return msgspec.structs.replace(criteria, **asked)


def _schedule(scenario: Scenario, path: str | None, other: str | None) -> Schedule:
    """The schedule: another file's, one named in the scenario, or the one written there."""
    if other is not None:
        return read_schedule(other)
    section = scenario.schedule
    if isinstance(section, str):
        return read_schedule(Path(path or ".").parent / section)
    data = section if isinstance(section, dict) else {"faults": section or []}
    where = path or "the demo scenario"
    return parse_schedule({"seed": scenario.seed, **data}, where, _lines(path, section))


def _lines(path: str | None, section: object) -> Lines | None:
    """The lines of the scenario's file on which the parts of its schedule stand."""
    if path is None:
        return None
    _, lines = read_yaml(Path(path).read_text(encoding="utf-8"), path)
    head = () if isinstance(section, dict) else ("faults",)
    return {(*head, *at[1:]): line for at, line in lines.items() if at[:1] == ("schedule",)}
