"""Refuse faults of parts that the simulated vehicle lacks: they would act on nothing."""

from collections.abc import Callable, Iterable

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.faults.plant_fault import SimulatorFault
from mavproxy_fault.schedule.entries import Entry
from simvehicle.hil.actuator_commands import actuator_channels
from simvehicle.simulation.simulation import Simulation

CHANNEL = "HIL_ACTUATOR_CONTROLS.controls["


def check_parts(entries: Iterable[Entry], simulated: Callable[[], Simulation]) -> None:
    """Refuse plant parameters and actuator channels that the `simulated` vehicle does not have.

    Raises
    ------
    ConfigError
        Names every such fault, and what the vehicle has.
    """
    errors, simulation = [], None
    for entry in entries:
        channels = [name for name in entry.targets if name.startswith(CHANNEL)]
        parts = entry.fault.names if isinstance(entry.fault, SimulatorFault) else channels
        for name in parts:
            # Created for these faults alone, since it takes longer than reading a schedule.
            simulation = simulation or simulated()
            try:
                _check_part(name, simulation)
            except ConfigError as error:
                errors.append(f"fault {entry.id}: {error}")
    if errors:
        raise ConfigError("\n".join(errors))


def _check_part(name: str, simulation: Simulation) -> None:
    if not name.startswith(CHANNEL):
        simulation.check_plant(name)
        return
    actuators = simulation.kind.actuators(simulation.vehicle)
    outputs = zip(actuators, actuator_channels(actuators), strict=True)
    driven = {f"{CHANNEL}{channel}]": one for one, pairs in outputs for channel, _ in pairs}
    if name not in driven:
        known = ", ".join(f"{channel} ({one})" for channel, one in driven.items())
        raise ConfigError(f"{name} drives no actuator of this vehicle; use {known}")
