"""ArduPilot in a run: the bridge, which starts the autopilot and ends it."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from analysis.autopilots.ardupilot.ardupilot_requests import COPTER, PLANE, ArduPilotRequests
from analysis.autopilots.flight_operator import Requests
from analysis.autopilots.flight_plan import flight_plan
from analysis.autopilots.hil_exchange import BRIDGE_STEP
from analysis.autopilots.own_parameters import text_of
from analysis.autopilots.program import Program
from mavproxy_fault.ardupilot.autopilot_process import check_command
from mavproxy_fault.ardupilot.bridge_command import checked_parameters
from mavproxy_fault.ardupilot.bridged_autopilot import BridgedAutopilot
from mavproxy_fault.ardupilot.parameters import Kind
from simvehicle.simulation.simulation import Simulation

KINDS: dict[str, Kind] = {
    "multirotor": "copter",
    "fixedwing": "plane",
}  # of the bridge, by the scenario's
BINARIES = {kind: f"ardu{name}" for kind, name in KINDS.items()}
MODES = {"multirotor": COPTER, "fixedwing": PLANE}


def command(binary: str) -> list[str]:
    """The words that start it; ConfigError where there is no such program."""
    return check_command(binary)


@contextlib.contextmanager
def requests(simulation: Simulation) -> Iterator[Requests]:
    """How it is asked."""
    kind = simulation.scenario.vehicle.kind
    yield ArduPilotRequests(MODES[kind], flight_plan(simulation).landing)


@contextlib.contextmanager
def started(
    words: Sequence[str], simulation: Simulation, folder: Path, own: dict[str, float]
) -> Iterator[Program]:
    """The bridge and its autopilot with the user's `own` parameters; both end with the flight."""
    path, kind = folder / "bridge.log", KINDS[simulation.scenario.vehicle.kind]
    files = []
    if own:
        file = folder / "own.parm"
        file.write_text(text_of(own))
        files = checked_parameters(str(file))
    with path.open("w", buffering=1) as log, contextlib.ExitStack() as stack:
        # In this process: a process of its own would cost each step two changes between them.
        bridged = BridgedAutopilot(
            words, kind, folder / "autopilot", files, lambda line: print(line, file=log)
        )
        stack.callback(bridged.close)
        yield Program("ArduPilot", bridged, [bridged], path, BRIDGE_STEP)
