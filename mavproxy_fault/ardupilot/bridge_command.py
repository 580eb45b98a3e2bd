"""The `ardupilot` command: the bridge, and the ArduPilot that it starts and ends.

Like PX4, the bridge sends the first message: a simulator waits for it.
"""

import argparse
import contextlib
import select
import sys
import time
from collections.abc import Callable
from pathlib import Path

from mavproxy_fault.ardupilot.autopilot_process import check_command
from mavproxy_fault.ardupilot.bridged_autopilot import BridgedAutopilot
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.ardupilot.parameters import VehicleKind
from mavproxy_fault.ardupilot.wired_autopilot import WiredAutopilot
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.parameter_list import read_parameters
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

MAV_TYPES: dict[VehicleKind, int] = {"copter": 2, "plane": 1}
ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
WAIT_S = 0.5  # between checks of both sides
SILENCE_S = 5.0  # without a step until a warning; chosen: no false alarm on a busy machine


class FlightEndError(RuntimeError):
    """One side of the bridge was closed."""


def main(args: argparse.Namespace) -> int:
    """Run `mavproxy-fault ardupilot`; the exit code is 1 if the flight ended while armed or the
    autopilot process failed."""
    check_connection_options(args)
    command = [] if args.binary is None else check_command(args.binary)
    own = read_parameters(args.parameters)
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link(args.hil)))
        autopilot: BridgedAutopilot | WiredAutopilot
        if command:
            folder = Path(args.out)
            autopilot = BridgedAutopilot(
                command, args.vehicle, folder, own, print_status, link.name
            )
        else:
            lines = open_link(args.vectornav), open_link(args.mavlink)
            autopilot = WiredAutopilot(*lines, args.vehicle, print_status, link.name)
        stack.callback(autopilot.close)
        try:
            print_status(f"{link.name}: waiting for the simulator")
            BridgeLoop(link, autopilot, print_status).run(hello_heartbeat(args.vehicle))
        except FlightEndError as end:
            print_status(str(end))
            return int(autopilot.armed or bool(autopilot.poll()))
        except KeyboardInterrupt:
            print_status("stopped")
    return 0


def check_connection_options(args: argparse.Namespace) -> None:
    """Require either --binary or both connections to a board.

    Raises
    ------
    ConfigError
        With the missing or conflicting option.
    """
    # A board needs both: sensors in, outputs back.
    wired = args.vectornav is not None, args.mavlink is not None
    if args.binary is not None and any(wired):
        raise ConfigError("--binary: starts SITL; omit --vectornav and --mavlink (for a board)")
    if args.binary is None and not all(wired):
        raise ConfigError(
            "ardupilot: needs --binary (ArduPilot's SITL program), or both --vectornav and "
            "--mavlink (connections to a board)"
        )


class BridgeLoop:
    """Carries frames between a HIL link and the autopilot until either is closed."""

    def __init__(
        self,
        link: Link,
        autopilot: BridgedAutopilot | WiredAutopilot,
        say: Callable[[str], None],
        silence_s: float = SILENCE_S,
    ) -> None:
        self._link, self._autopilot = link, autopilot
        self._say, self._silence_s = say, silence_s
        self._steps = -1  # at the last check
        self._silent_s: float | None = None  # time of the last step; None after the warning

    def run(self, word: bytes) -> None:
        """Exchange frames; the first message `word` is repeated until the autopilot has started.

        Raises
        ------
        FlightEndError
            With the side that was closed, and when.
        ConfigError
            If the autopilot cannot fly on the available sensors.
        """
        link, autopilot, inbox = self._link, self._autopilot, Inbox(self._link)
        look_s = 0.0
        while True:
            select.select([*link.filenos(), *autopilot.filenos()], [], [], WAIT_S)
            for frame in inbox.frames():
                autopilot.receive(frame)
            for _, data in autopilot.read():
                link.write(data)
            # Before the start a proxy may still be starting or restarting.
            if autopilot.started and not link.peer_count:
                raise self._ended(f"{link.name}: the HIL link was closed")
            if (now_s := time.monotonic()) >= look_s:
                look_s = now_s + WAIT_S
                # Repeated, as UDP may lose the first.
                if not autopilot.started and link.peer_count:
                    link.write(word)
                if (code := autopilot.poll()) is not None:
                    raise self._ended(f"the autopilot process ended {describe_exit(code)}")
                self._watch_silence(now_s)

    def _watch_silence(self, now_s: float) -> None:
        """Warn once that no step arrives: the simulator may have died behind a proxy."""
        if self._autopilot.steps != self._steps:
            self._steps, self._silent_s = self._autopilot.steps, now_s
        elif self._silent_s is not None and now_s - self._silent_s > self._silence_s:
            self._say(f"{self._link.name}: no step for {self._silence_s:g} s; still waiting")
            self._silent_s = None

    def _ended(self, reason: str) -> FlightEndError:
        """Create the error that reports what ended the flight, and when."""
        flying = ", in flight" if self._autopilot.armed else ""
        at_s = self._autopilot.t_us * 1e-6
        return FlightEndError(f"{reason} at {at_s:.3f} s of vehicle time{flying}")


def hello_heartbeat(kind: VehicleKind) -> bytes:
    """Encode the bridge's first message, a HEARTBEAT."""
    values = {"type": MAV_TYPES[kind], "autopilot": ARDUPILOT, "mavlink_version": 3}
    return build_frame(message_layout("HEARTBEAT"), values)


def print_status(text: str) -> None:
    """Print a status line on standard error."""
    print(text, file=sys.stderr, flush=True)
