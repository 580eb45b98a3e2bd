"""Start an unmodified PX4 SITL binary with the links and parameters of a run.

PX4's start script reads the airframe from PX4_SIM_MODEL and parameters from PX4_PARAM_*, and finds
`px4-rc.mavlink`, its streams, through the PATH [1]_. So the run's folder comes first in it.

References
----------
.. [1] PX4, `ROMFS/px4fmu_common/init.d-posix/rcS` and `px4-rc.mavlinksim`.
"""

import contextlib
import os
import shlex
import shutil
import socket
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

from analysis.autopilots.flight_plan import flight_plan
from analysis.autopilots.hil_exchange import PX4_STEP
from analysis.autopilots.operator_commands import OperatorModes
from analysis.autopilots.px4.px4_parameters import AIRFRAMES, STREAMS_HZ, run_parameters
from analysis.autopilots.running_autopilot import RunningAutopilot, terminate_on_exit
from mavproxy_fault.ardupilot.child_process import die_with_parent
from mavproxy_fault.documents.atomic_file import replace_file
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.links.udp import UdpServer
from simvehicle.simulation.simulation import Simulation

BINARIES = dict.fromkeys(AIRFRAMES, "px4")
# Main modes and the sub-modes of AUTO: LOITER, TAKEOFF, MISSION, LAND
MANUAL, HOLD, TAKE_OFF, MISSION, LAND = (1,), (4, 3), (4, 2), (4, 4), (4, 6)
MODES = {
    "multirotor": OperatorModes((HOLD,), TAKE_OFF, MISSION, LAND),
    # In its automatic mode PX4's height controller runs from before the estimator knew the height
    # of the field, and would start a climb from sea level. It restarts after a second without it.
    # The mode LAND assumes a field at sea level.
    "fixedwing": OperatorModes((MANUAL, MANUAL, MANUAL, HOLD), TAKE_OFF, MISSION, ()),
}
LOOPBACK = "127.0.0.1"
FIRST_PORT = 4560  # TCP port at which instance 0 expects its simulator
MAX_INSTANCES = 100
STARTUP_TEXT = "Startup script returned"  # its last lines start the logger


def launch_command(binary: str) -> list[str]:
    """Return the command line that starts PX4.

    Raises
    ------
    ConfigError
        If the binary or its start scripts are missing.
    """
    arguments = shlex.split(binary)
    path = shutil.which(arguments[0]) if arguments else None
    scripts = Path(path).resolve().parent.parent / "etc" if path else None
    if path is None or scripts is None or not (scripts / "init.d-posix" / "rcS").is_file():
        problem = "not found" if path is None else f"has no {scripts}/init.d-posix/rcS"
        raise ConfigError(
            f"--binary: {binary!r} {problem}; give PX4's SITL binary, which "
            "`make px4_sitl_default` leaves in build/px4_sitl_default/bin/px4"
        )
    return [str(Path(path).resolve()), *arguments[1:], "-d", str(scripts)]


@contextlib.contextmanager
def start_autopilot(
    arguments: Sequence[str], simulation: Simulation, folder: Path, overrides: dict[str, float]
) -> Iterator[RunningAutopilot]:
    """Start PX4 in its own folder, with parameter `overrides`; it ends with the flight."""
    work_folder = (folder / "autopilot").resolve()
    work_folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        instance, hil = open_free_instance()
        stack.callback(hil.close)
        telemetry = stack.enter_context(contextlib.closing(UdpServer(LOOPBACK, 0)))
        (work_folder / "px4-rc.mavlink").write_text(stream_script(free_udp_port(), telemetry.port))
        path = work_folder / "px4.log"
        with replace_file(path) as log:
            process = subprocess.Popen(
                [*arguments, "-i", str(instance), "-w", str(work_folder)],
                env=process_environment(simulation, work_folder, overrides),
                cwd=work_folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                process_group=0,  # Ctrl-C must reach the run only
                preexec_fn=die_with_parent,
            )
        stack.enter_context(terminate_on_exit(process))
        yield RunningAutopilot("PX4", process, [hil, telemetry], path, PX4_STEP, STARTUP_TEXT)


def open_free_instance() -> tuple[int, TcpServer]:
    """Open a server on the port of the first free instance; return the instance and the server.

    Raises
    ------
    ConfigError
        If no port is free.
    """
    for instance in range(MAX_INSTANCES):
        with contextlib.suppress(OSError):
            # Kept open: a port that is only probed may be taken in between.
            return instance, TcpServer(LOOPBACK, FIRST_PORT + instance)
    raise ConfigError(
        f"--autopilot px4: no TCP port from {FIRST_PORT} to {FIRST_PORT + MAX_INSTANCES - 1} is "
        "free; close another simulator"
    )


def free_udp_port() -> int:
    """Return a UDP port that PX4 can bind."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def stream_script(local: int, remote: int) -> str:
    """Write the start script of PX4's MAVLink instance, with the streams that a run records."""
    lines = [f"mavlink start -x -u {local} -o {remote} -t {LOOPBACK} -r 1000000 -m custom"]
    lines += [f"mavlink stream -u {local} -s {name} -r {hz}" for name, hz in STREAMS_HZ.items()]
    return "\n".join(lines) + "\n"


def process_environment(
    simulation: Simulation, folder: Path, overrides: dict[str, float]
) -> dict[str, str]:
    """Return PX4's environment; `overrides` parameters override those of the run."""
    # Without the PX4_* variables of the user's shell: they may select another simulator.
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PX4_")}
    variables["PATH"] = f"{folder}{os.pathsep}{variables.get('PATH', os.defpath)}"
    variables["PX4_SIM_MODEL"] = AIRFRAMES[simulation.scenario.vehicle.kind]
    values = run_parameters(simulation, flight_plan(simulation).height_m) | overrides
    return variables | {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in values.items()}
