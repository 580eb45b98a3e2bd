"""ArduPilot in a run: the bridge's process, which starts the autopilot and ends it."""

import contextlib
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from analysis.autopilots.ardupilot_requests import COPTER, PLANE, ArduPilotRequests
from analysis.autopilots.flight_operator import Requests
from analysis.autopilots.hil_exchange import BRIDGE_STEP
from analysis.autopilots.own_parameters import text_of
from analysis.autopilots.program import Program, ended
from mavproxy_fault.ardupilot.autopilot_process import check_command
from mavproxy_fault.links.tcp import TcpServer
from simvehicle.simulation.simulation import Simulation

KINDS = {"multirotor": "copter", "fixedwing": "plane"}  # of the bridge, by the scenario's
MODES = {"multirotor": COPTER, "fixedwing": PLANE}


def command(binary: str | None) -> list[str]:
    """The words that start it; ConfigError where there is no such program."""
    return check_command(binary or "arducopter", option="--binary")


@contextlib.contextmanager
def requests(simulation: Simulation) -> Iterator[Requests]:
    """How it is asked."""
    yield ArduPilotRequests(MODES[simulation.scenario.vehicle.kind])


@contextlib.contextmanager
def started(
    words: Sequence[str], simulation: Simulation, folder: Path, own: dict[str, float]
) -> Iterator[Program]:
    """The bridge and its autopilot with the user's `own` parameters; both end with the flight."""
    # Any free port, so that several runs can be flown at once.
    with contextlib.closing(TcpServer("127.0.0.1", 0)) as link:
        bridge = [sys.executable, "-m", "mavproxy_fault.cli", "ardupilot"]
        bridge += ["--hil", f"tcp:127.0.0.1:{link.port}", "--command", shlex.join(words)]
        bridge += ["--vehicle", KINDS[simulation.scenario.vehicle.kind]]
        bridge += ["--dir", str(folder / "autopilot")]
        if own:
            file = folder / "own.parm"
            file.write_text(text_of(own))
            bridge += ["--parameters", str(file)]
        path = folder / "bridge.log"
        with path.open("wb") as log:
            process = subprocess.Popen(
                bridge,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                process_group=0,  # Ctrl-C is the run's
            )
        with ended(process):
            yield Program("the bridge", process, [link], path, BRIDGE_STEP)
