"""Start ArduPilot for a run through the bridge, which starts and ends the autopilot."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from analysis.autopilots.hil_exchange import BRIDGE_STEP
from analysis.autopilots.operator_commands import OperatorModes
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
GUIDED, LAND, AUTO, TAKEOFF, PLANE_AUTO, AUTOLAND = (4,), (9,), (3,), (13,), (10,), (26,)
MODES = {
    "multirotor": OperatorModes(
        (GUIDED,), GUIDED, AUTO, LAND, climbs_by_command=True, home_is_first=True
    ),
    "fixedwing": OperatorModes((TAKEOFF,), TAKEOFF, PLANE_AUTO, AUTOLAND, home_is_first=True),
}


def launch_command(binary: str) -> list[str]:
    """Return the command line that starts it; ConfigError if the binary does not exist."""
    return check_command(binary)


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
