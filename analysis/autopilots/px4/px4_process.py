"""PX4 in a run: its SITL program, unmodified, started on links and parameters of the run's own.

PX4's start script reads the airframe from PX4_SIM_MODEL and parameters from PX4_PARAM_*, and looks
for `px4-rc.mavlink`, its streams, along the PATH [1]_. So the run's folder comes first there.

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

from analysis.autopilots.flight_operator import AutopilotCommands
from analysis.autopilots.flight_plan import flight_plan
from analysis.autopilots.hil_exchange import PX4_STEP
from analysis.autopilots.px4.px4_parameters import AIRFRAMES, STREAMS_HZ, run_parameters
from analysis.autopilots.running_autopilot import RunningAutopilot, terminate_on_exit
from mavproxy_fault.ardupilot.child_process import die_with_parent
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.links.udp import UdpServer
from simvehicle.simulation.simulation import Simulation

BINARIES = dict.fromkeys(AIRFRAMES, "px4")
LOOPBACK = "127.0.0.1"
FIRST_PORT = 4560  # TCP, where instance 0 looks for its simulator
MAX_INSTANCES = 100
STARTUP_TEXT = "Startup script returned"  # the logger is started by its last lines


def launch_command(binary: str) -> list[str]:
    """The words that start it.

    Raises
    ------
    ConfigError
        If there is no such program, or it stands without its start scripts.
    """
    words = shlex.split(binary)
    found = shutil.which(words[0]) if words else None
    scripts = Path(found).resolve().parent.parent / "etc" if found else None
    if found is None or scripts is None or not (scripts / "init.d-posix" / "rcS").is_file():
        wrong = "is no program" if found is None else f"stands without {scripts}/init.d-posix/rcS"
        raise ConfigError(
            f"--binary: {binary!r} {wrong}; give PX4's SITL binary, which "
            "`make px4_sitl_default` leaves in build/px4_sitl_default/bin/px4"
        )
    return [str(Path(found).resolve()), *words[1:], "-d", str(scripts)]


@contextlib.contextmanager
def open_commands(simulation: Simulation) -> Iterator[AutopilotCommands]:
    """How it is asked; MAVSDK is slow to import."""
    from analysis.autopilots.px4.mavsdk_commands import MavsdkCommands

    with contextlib.closing(MavsdkCommands(flight_plan(simulation).landing)) as found:
        yield found


@contextlib.contextmanager
def start_autopilot(
    words: Sequence[str], simulation: Simulation, folder: Path, own: dict[str, float]
) -> Iterator[RunningAutopilot]:
    """PX4 in a folder of its own, with the user's `own` parameters; it ends with the flight."""
    place = (folder / "autopilot").resolve()
    place.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        instance, hil = open_free_instance()
        stack.callback(hil.close)
        telemetry = stack.enter_context(contextlib.closing(UdpServer(LOOPBACK, 0)))
        (place / "px4-rc.mavlink").write_text(stream_script(free_udp_port(), telemetry.port))
        path = place / "px4.log"
        with path.open("wb") as log:
            process = subprocess.Popen(
                [*words, "-i", str(instance), "-w", str(place)],
                env=process_environment(simulation, place, own),
                cwd=place,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                process_group=0,  # Ctrl-C is the run's
                preexec_fn=die_with_parent,
            )
        stack.enter_context(terminate_on_exit(process))
        yield RunningAutopilot("PX4", process, [hil, telemetry], path, PX4_STEP, STARTUP_TEXT)


def open_free_instance() -> tuple[int, TcpServer]:
    """The first number whose port is free, and the server there.

    Raises
    ------
    ConfigError
        If none is.
    """
    for instance in range(MAX_INSTANCES):
        with contextlib.suppress(OSError):
            # Opened at once and kept: a port that is only looked at may be taken in between.
            return instance, TcpServer(LOOPBACK, FIRST_PORT + instance)
    raise ConfigError(
        f"--autopilot px4: no TCP port from {FIRST_PORT} to {FIRST_PORT + MAX_INSTANCES - 1} is "
        "free; end a simulator"
    )


def free_udp_port() -> int:
    """A port that PX4 may bind."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def stream_script(local: int, remote: int) -> str:
    """The start script of PX4's one MAVLink instance: the streams a run records."""
    lines = [f"mavlink start -x -u {local} -o {remote} -t {LOOPBACK} -r 1000000 -m custom"]
    lines += [f"mavlink stream -u {local} -s {name} -r {hz}" for name, hz in STREAMS_HZ.items()]
    return "\n".join(lines) + "\n"


def process_environment(
    simulation: Simulation, place: Path, own: dict[str, float]
) -> dict[str, str]:
    """PX4's variables, with `own` parameters over those of the run; those of the user's shell that
    name another simulator are left out."""
    # What the user exported for another simulator would start that one.
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PX4_")}
    kept["PATH"] = f"{place}{os.pathsep}{kept.get('PATH', os.defpath)}"
    kept["PX4_SIM_MODEL"] = AIRFRAMES[simulation.scenario.vehicle.kind]
    values = run_parameters(simulation, flight_plan(simulation).height_m) | own
    return kept | {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in values.items()}
