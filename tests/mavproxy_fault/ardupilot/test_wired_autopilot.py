"""ArduPilot on a board: the entire command between a simulator and two serial lines."""

import os
import pty
import select
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from tests.mavproxy_fault.ardupilot.test_bridge import PATIENCE_S, Simulator

HANDSHAKE = Path(__file__).resolve().parents[2] / "data" / "arducopter" / "handshake.txt"
ARMED = 128


class Board:
    """The output of a board: the recorded handshake, heartbeats, servo outputs, replies."""

    def __init__(self, sensor: int, mavlink: int) -> None:
        self._sensor, self._mavlink = sensor, mavlink
        self._parser = Parser()
        self.sensed = b""
        self.requests: list[Frame] = []
        # Only after the bridge has opened the line: earlier data would be discarded.
        self._greeting = HANDSHAKE.read_bytes()

    def turn(self, pwm_us: int) -> None:
        """Send pending output and read input."""
        if self._greeting:
            os.write(self._sensor, self._greeting)
            self._greeting = b""
        outputs = {f"servo{output}_raw": pwm_us for output in range(1, 5)}
        self._say("HEARTBEAT", type=2, autopilot=3, base_mode=ARMED)
        self._say("SERVO_OUTPUT_RAW", **outputs)
        for descriptor in select.select([self._sensor, self._mavlink], [], [], 0)[0]:
            data = os.read(descriptor, 65536)
            if descriptor == self._sensor:
                self.sensed += data
                continue
            self.requests += [item for item in self._parser.push(data) if isinstance(item, Frame)]

    def _say(self, name: str, **values: object) -> None:
        os.write(self._mavlink, build_frame(message_layout(name), values))


@contextmanager
def line() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    try:
        yield master, f"{os.ttyname(slave)},921600"
    finally:
        os.close(master)
        os.close(slave)


def test_a_board_is_fed_over_its_lines_and_its_outputs_fly_the_vehicle() -> None:
    with closing(TcpServer("127.0.0.1", 0)) as link, line() as (sensor, a), line() as (mav, b):
        command = [sys.executable, "-m", "mavproxy_fault.cli", "ardupilot"]
        command += ["--hil", f"tcp:127.0.0.1:{link.port}", "--vectornav", a, "--mavlink", b]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        simulator, board = Simulator(Inbox(link)), Board(sensor, mav)
        try:
            deadline_s = time.monotonic() + PATIENCE_S
            # Each turn processes available data: neither side waits for the other.
            while len(simulator.answers) < 30 or b"\xfa\x01\x21\x07" not in board.sensed:
                assert time.monotonic() < deadline_s
                if simulator.others:  # the bridge has sent its first message
                    simulator.step()
                    board.turn(1700)
                simulator.listen(0.002)
        finally:
            process.kill()
            process.communicate()
    last = simulator.answers[-1]
    assert last.number("controls", 0) == pytest.approx(0.7)
    assert int(last.number("mode")) & ARMED
    (request,) = {
        (frame.number("command"), frame.number("param1"))
        for frame in board.requests
        if frame.layout.name == "COMMAND_LONG"
    }
    assert request == (511, 36)  # a stream of outputs, first of all
    assert "SERVO_OUTPUT_RAW" in {frame.layout.name for frame in simulator.others}


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([], "needs --binary (ArduPilot's SITL program), or both --vectornav"),
        (["--vectornav", "udpin:127.0.0.1:0"], "needs --binary"),
        (["--binary", "true", "--mavlink", "udpin:127.0.0.1:0"], "--binary: starts SITL"),
    ],
)
def test_a_board_with_one_connection_is_refused(words: list[str], reason: str) -> None:
    command = [sys.executable, "-m", "mavproxy_fault.cli", "ardupilot", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert reason in done.stderr
