"""The `ardupilot` command: the bridge, and the ArduPilot that it starts and ends."""

import argparse
import contextlib
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from mavproxy_fault.ardupilot.autopilot_process import PARAMETERS, Ports, check_command, start
from mavproxy_fault.ardupilot.bridge import Bridge, FlightEndError
from mavproxy_fault.ardupilot.bridge_ports import Datagrams, SensorPort
from mavproxy_fault.ardupilot.observation import observe
from mavproxy_fault.ardupilot.outputs import motor_channels, plane_channels
from mavproxy_fault.ardupilot.parameters import check, file_text, parameters
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.spec import open_link

CHANNELS = {"copter": motor_channels, "plane": plane_channels}
END_S = 3.0  # for the autopilot to close its log


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault ardupilot`; the exit code is 1 if the flight ended while armed."""
    words = check_command(args.command)
    folder = Path(args.dir)
    folder.mkdir(parents=True, exist_ok=True)
    defaults = [folder / PARAMETERS, *checked_parameters(args.parameters)]
    with contextlib.ExitStack() as stack:
        link = open_link(args.hil)
        ports = Datagrams(), Datagrams(), SensorPort()
        for opened in (link, *ports):
            stack.callback(opened.close)
        inbox = Inbox(link)
        try:
            say(f"{link.name}: waiting for the simulator")
            seen = observe(inbox, args.vehicle)
            defaults[0].write_text(file_text(parameters(args.vehicle, seen.fitted)))
            say(f"{words[0]}: starting in {folder}, {seen.fitted.rate_hz:g} steps a second")
            numbers = Ports(*(port.port for port in ports))
            process = start(words, folder, numbers, seen.home, defaults)
            bridge = Bridge(inbox, seen, ports, CHANNELS[args.vehicle], say)
            with ended(process, bridge):
                bridge.run(process)
        except FlightEndError as end:
            say(str(end))
            return int(end.in_flight)
        except KeyboardInterrupt:
            say("stopped")
    return 0


def checked_parameters(file: str | None) -> list[Path]:
    """The user's parameter file, if there is one and it keeps the truth from the estimator."""
    if file is None:
        return []
    try:
        lines = Path(file).read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read ({error}); give a parameter file") from None
    check(lines, file)
    return [Path(file)]


@contextlib.contextmanager
def ended(process: "subprocess.Popen[bytes]", bridge: Bridge) -> Iterator[None]:
    """End the program in the end: it closes its log while it is still given physics."""
    try:
        yield
    finally:
        process.terminate()
        until_s = time.monotonic() + END_S
        while process.poll() is None and time.monotonic() < until_s:
            select.select([bridge.physics], [], [], 0.1)
            bridge.drain()
        process.kill()
        process.wait()


def say(text: str) -> None:
    """A line to the person in front of the bridge."""
    print(text, file=sys.stderr, flush=True)
