"""Start ArduPilot for a run through the bridge, which starts and ends the autopilot."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from analysis.autopilots.ardupilot.ardupilot_commands import COPTER, PLANE, ArduPilotCommands
from analysis.autopilots.flight_operator import AutopilotCommands
from analysis.autopilots.flight_plan import flight_plan
from analysis.autopilots.hil_exchange import BRIDGE_STEP
from analysis.autopilots.running_autopilot import RunningAutopilot
from mavproxy_fault.ardupilot.autopilot_process import check_command
from mavproxy_fault.ardupilot.bridged_autopilot import BridgedAutopilot
from mavproxy_fault.ardupilot.parameters import VehicleKind
from simvehicle.simulation.simulation import Simulation

KINDS: dict[str, VehicleKind] = {
    "multirotor": "copter",
    "fixedwing": "plane",
}  # vehicle of the bridge by kind in the scenario
BINARIES = {kind: f"ardu{name}" for kind, name in KINDS.items()}
MODES = {"multirotor": COPTER, "fixedwing": PLANE}


def launch_command(binary: str) -> list[str]:
    """Return the command line that starts it; ConfigError if the binary does not exist."""
    return check_command(binary)


@contextlib.contextmanager
def open_commands(simulation: Simulation) -> Iterator[AutopilotCommands]:
    """Open the commands for ArduPilot."""
    kind = simulation.scenario.vehicle.kind
    yield ArduPilotCommands(MODES[kind], flight_plan(simulation).landing)


@contextlib.contextmanager
def start_autopilot(
    arguments: Sequence[str], simulation: Simulation, folder: Path, overrides: dict[str, float]
) -> Iterator[RunningAutopilot]:
    """Start the bridge and ArduPilot with the user's `overrides` parameters, for one flight."""
    path, kind = folder / "bridge.log", KINDS[simulation.scenario.vehicle.kind]
    with path.open("w", buffering=1) as log, contextlib.ExitStack() as stack:
        # In this process: a separate one would cost two context switches per step.
        bridge = BridgedAutopilot(
            arguments, kind, folder / "autopilot", overrides, lambda line: print(line, file=log)
        )
        stack.callback(bridge.close)
        yield RunningAutopilot("ArduPilot", bridge, [bridge], path, BRIDGE_STEP)
