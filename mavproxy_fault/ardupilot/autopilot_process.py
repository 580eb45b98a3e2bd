"""ArduPilot's SITL process, started with the bridge's ports and parameters; ends with it."""

import shlex
import shutil
import subprocess
from pathlib import Path

from mavproxy_fault.ardupilot.child_process import die_with_parent
from mavproxy_fault.ardupilot.hil_readings import TrueState
from mavproxy_fault.documents.atomic_file import replace_file
from mavproxy_fault.documents.errors import ConfigError

OUTPUT_LOG = "autopilot.log"
PARAMETER_FILE = "bridge.parm"
SPEEDUP = 100  # unreachably high, so that the HIL link sets the pace, not ArduPilot's sleep


def check_command(binary: str) -> list[str]:
    """Split a command into arguments and resolve its program.

    Raises
    ------
    ConfigError
        If the program does not exist.
    """
    arguments = shlex.split(binary)
    program = shutil.which(arguments[0]) if arguments else None
    if program is None:
        raise ConfigError(
            f"--binary: {binary!r} is not a program; give ArduPilot's SITL binary, which "
            "`./waf configure --board sitl && ./waf copter` builds as build/sitl/bin/arducopter"
        )
    return [str(Path(program).resolve()), *arguments[1:]]


def start_process(
    command: list[str], folder: Path, home: TrueState, *, physics: int, mavlink: int, vectornav: int
) -> "subprocess.Popen[bytes]":
    """Start the program in `folder`, with the parameters of its `PARAMETER_FILE`.

    The bridge's ports on the loopback address are UDP for physics and MAVLink, TCP for the sensor.
    """
    place = f"{home.lat_e7 * 1e-7:.7f},{home.lon_e7 * 1e-7:.7f},{home.alt_mm * 1e-3:.3f}"
    options = {
        "--model": "JSON:127.0.0.1",
        "--home": f"{place},{home.yaw_deg:.2f}",
        "--defaults": PARAMETER_FILE,
        "--speedup": str(SPEEDUP),
        "--sim-port-out": str(physics),
        **{f"--serial{number}": "none:" for number in range(9)},
        "--serial0": f"udpclient:127.0.0.1:{mavlink}",
        "--serial6": f"tcpclient:127.0.0.1:{vectornav}",
    }
    arguments = [word for option in options.items() for word in option]
    with replace_file(folder / OUTPUT_LOG) as output:
        return subprocess.Popen(
            [*command, "-w", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            preexec_fn=die_with_parent,
        )
