"""The `ardupilot` command: the bridge, and the ArduPilot that it starts and ends.

PX4 speaks first, and so does the bridge: a simulator waits for a word.
"""

import argparse
import contextlib
import select
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from mavproxy_fault.ardupilot.autopilot_process import check_command
from mavproxy_fault.ardupilot.bridged_autopilot import BridgedAutopilot
from mavproxy_fault.ardupilot.child_process import describe_exit
from mavproxy_fault.ardupilot.parameters import VehicleKind, check_parameter_file
from mavproxy_fault.ardupilot.wired_autopilot import WiredAutopilot
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Chunk, Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

MAV_TYPES: dict[VehicleKind, int] = {"copter": 2, "plane": 1}
ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
WAIT_S = 0.5  # between looks at both sides
SILENCE_S = 5.0  # without a step, after which it is told


class FlightEndError(RuntimeError):
    """A side of the bridge went away."""


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault ardupilot`; the exit code is 1 if the flight ended while armed, or the
    program by a failure of its own."""
    check_connection_options(args)
    words = [] if args.binary is None else check_command(args.binary)
    own = user_parameter_files(args.parameters)
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(open_link(args.hil)))
        autopilot: BridgeAutopilot
        if words:
            folder = Path(args.out)
            autopilot = BridgedAutopilot(words, args.vehicle, folder, own, print_status, link.name)
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
    """Refuse half a board, and a board beside a program.

    Raises
    ------
    ConfigError
        With the option that is missing or too many.
    """
    # Sensors without outputs fly nothing, and outputs without sensors neither.
    wired = args.vectornav is not None, args.mavlink is not None
    if args.binary is not None and any(wired):
        raise ConfigError("--binary: is a program; --vectornav and --mavlink are lines to a board")
    if args.binary is None and not all(wired):
        raise ConfigError(
            "ardupilot: needs --binary, ArduPilot's SITL program, or --vectornav and --mavlink, "
            "the lines to a board"
        )


class BridgeAutopilot(Protocol):
    """What the exchange needs of ArduPilot, whether a program or a board."""

    @property
    def started(self) -> bool: ...
    @property
    def armed(self) -> bool: ...
    @property
    def steps(self) -> int: ...
    @property
    def t_us(self) -> int: ...
    def filenos(self) -> list[int]: ...
    def poll(self) -> int | None: ...
    def receive(self, frame: Frame) -> None: ...
    def read(self) -> list[Chunk]: ...
    def close(self) -> None: ...


class BridgeLoop:
    """Carries frames between a HIL link and the autopilot until either goes away."""

    def __init__(
        self,
        link: Link,
        autopilot: BridgeAutopilot,
        say: Callable[[str], None],
        silence_s: float = SILENCE_S,
    ) -> None:
        self._link, self._autopilot = link, autopilot
        self._say, self._silence_s = say, silence_s
        self._steps = -1  # at the last look
        self._silent_s: float | None = None  # when the last step was seen; None once it is told

    def run(self, word: bytes) -> None:
        """Exchange, after a first `word` that is repeated until the autopilot has started.

        Raises
        ------
        FlightEndError
            With what went away and when.
        ConfigError
            If the autopilot does not fly on what comes.
        """
        link, autopilot, inbox = self._link, self._autopilot, Inbox(self._link)
        look_s = 0.0
        while True:
            select.select([*link.filenos(), *autopilot.filenos()], [], [], WAIT_S)
            for frame in inbox.frames():
                autopilot.receive(frame)
            for _, data in autopilot.read():
                link.write(data)
            # Before that a proxy may still be starting, or start anew.
            if autopilot.started and not link.peer_count:
                raise self._ended(f"{link.name}: the HIL link was closed")
            if (now_s := time.monotonic()) >= look_s:
                look_s = now_s + WAIT_S
                # Again and again: on UDP the first may be lost.
                if not autopilot.started and link.peer_count:
                    link.write(word)
                if (code := autopilot.poll()) is not None:
                    raise self._ended(f"the autopilot's program ended {describe_exit(code)}")
                self._watch_silence(now_s)

    def _watch_silence(self, now_s: float) -> None:
        """Tell once that no step comes: the simulator may have died behind a proxy."""
        if self._autopilot.steps != self._steps:
            self._steps, self._silent_s = self._autopilot.steps, now_s
        elif self._silent_s is not None and now_s - self._silent_s > self._silence_s:
            self._say(f"{self._link.name}: no step for {self._silence_s:g} s; still waiting")
            self._silent_s = None

    def _ended(self, reason: str) -> FlightEndError:
        """The error that says what ended the flight, and when."""
        flying = ", in flight" if self._autopilot.armed else ""
        at_s = self._autopilot.t_us * 1e-6
        return FlightEndError(f"{reason} at {at_s:.3f} s of vehicle time{flying}")


def hello_heartbeat(kind: VehicleKind) -> bytes:
    """The bridge's first word."""
    values = {"type": MAV_TYPES[kind], "autopilot": ARDUPILOT, "mavlink_version": 3}
    return build_frame(message_layout("HEARTBEAT"), values)


def user_parameter_files(file: str | None) -> list[Path]:
    """The user's parameter file, if there is one and it keeps the truth from the estimator."""
    if file is None:
        return []
    try:
        lines = Path(file).read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read ({error}); give a parameter file") from None
    check_parameter_file(lines, file)
    return [Path(file)]


def print_status(text: str) -> None:
    """A line to the person in front of the bridge."""
    print(text, file=sys.stderr, flush=True)
