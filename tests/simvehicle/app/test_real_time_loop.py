"""Hardware in the loop on a pty: the complete command, and an autopilot that replays PX4."""

import itertools
import os
import pty
import signal
import socket
import subprocess
import sys
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import StringIO
from pathlib import Path

import pytest

from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.app import lockstep_loop
from simvehicle.app.pace import Pace
from simvehicle.app.real_time_loop import FreeRunning, Overruns, RealTimeLoop
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import AutopilotSilentError
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import motor_mix

RECORDED = Path(__file__).resolve().parents[2] / "data" / "px4" / "hil.bin"
SCENARIO = """
name: bench
vehicle: {kind: multirotor, parameters: iris}
sensors:
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
  gps: {preset: consumer, rate_hz: 5}
"""


class Board:
    """The autopilot's end of the serial line."""

    def __init__(self, master: int) -> None:
        self._master, self._parser = master, Parser()
        self.frames: list[Frame] = []

    def read(self) -> list[Frame]:
        found = self._parser.push(os.read(self._master, 65536))
        frames = [item for item in found if isinstance(item, Frame)]
        self.frames += frames
        return frames

    def of(self, name: str) -> list[Frame]:
        return [frame for frame in self.frames if frame.layout.name == name]

    def until(self, count: int, name: str, answers: Iterator[bytes]) -> None:
        """Answer every other HIL_SENSOR, as a board that runs at its own rate does."""
        heard = 0
        while len(self.of(name)) < count:
            for frame in self.read():
                heard += frame.layout.name == "HIL_SENSOR"
                if frame.layout.name == "HIL_SENSOR" and heard % 2:
                    os.write(self._master, next(answers))


@contextmanager
def simulator(tmp_path: Path, *options: str) -> Iterator[tuple[Board, "subprocess.Popen[str]"]]:
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    scenario = tmp_path / "bench.yaml"
    scenario.write_text(SCENARIO)
    command = [sys.executable, "-m", "mavproxy_fault.cli", "sim", str(scenario)]
    process = subprocess.Popen(
        [*command, "--hil", f"{os.ttyname(slave)},921600", *options],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield Board(master), process
    finally:
        process.kill()
        process.communicate()
        os.close(master)
        os.close(slave)


def recorded() -> Iterator[bytes]:
    """PX4's recorded messages, repeated."""
    while True:
        for item in Parser().push(RECORDED.read_bytes()):
            assert isinstance(item, Frame)
            yield item.raw


def full_throttle() -> Iterator[bytes]:
    controls = message_layout("HIL_ACTUATOR_CONTROLS")
    while True:
        yield build_frame(
            controls, {"time_usec": 1, "controls": [0.9] * 4 + [0.0] * 12, "mode": 129}
        )


def test_a_board_that_answers_at_its_own_rate_flies_the_vehicle_in_real_time(tmp_path):
    with simulator(tmp_path) as (board, process):
        board.until(100, "HIL_SENSOR", recorded())
        stamps = [frame.number("time_usec") for frame in board.of("HIL_SENSOR")]
        assert {later - one for one, later in itertools.pairwise(stamps)} == {4000}
        on_ground = board.of("HIL_STATE_QUATERNION")[-1].number("alt")
        board.until(400, "HIL_SENSOR", full_throttle())
        assert board.of("HIL_STATE_QUATERNION")[-1].number("alt") > on_ground + 1000
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        said = process.stderr.read()
        assert process.wait() == 0
    assert "steps more than 1 ms late, the worst by" in said
    assert "lockstep from" not in said


@pytest.mark.parametrize("answers", [True, False])
def test_only_a_board_that_never_answers_is_reported(tmp_path, monkeypatch, answers):
    monkeypatch.setattr(lockstep_loop, "FIRST_ANSWER_TIMEOUT_S", 0.02)
    (tmp_path / "bench.yaml").write_text(SCENARIO)
    simulation, said = Simulation(read_scenario(tmp_path / "bench.yaml")), StringIO()
    with closing(TcpServer("127.0.0.1", 0)) as link:
        loop = RealTimeLoop(
            simulation, HilPacker(simulation.board), Inbox(link), motor_mix(4), Progress(0.0, said)
        )
        with socket.create_connection(("127.0.0.1", link.port), timeout=5) as board:
            first = (
                next(full_throttle()) if answers else build_frame(message_layout("HEARTBEAT"), {})
            )
            board.sendall(first)
            loop.run(until_us=100_000)
    assert ("no answer for 0.02 s; switch the board to HIL mode" in said.getvalue()) != answers
    assert "lockstep" not in said.getvalue()


def test_hardware_allows_real_time_only(tmp_path):
    with simulator(tmp_path, "--speed", "4") as (_, process):
        assert process.stderr is not None
        said = process.stderr.read()
        assert process.wait() == 2
    assert "--speed: 4 is not possible with hardware; use 1" in said


def test_the_flight_ends_if_controls_stop_but_not_if_none_ever_came():
    free = FreeRunning()
    free.sent(4000, 0.0)
    assert free.wait_s(100.0) == 0.0  # still starting up
    free.received(77, 100.0)
    assert (free.wait_s(129.0), free.silent_s(129.0)) == (0.0, 29.0)
    with pytest.raises(AutopilotSilentError, match="has not answered for 30 s"):
        free.wait_s(131.0)


def test_overruns_are_counted_above_one_millisecond():
    pace, overruns = Pace(1.0), Overruns()
    pace.wait_s(0, 10.0)
    for t_us, now_s in ((4000, 10.0041), (8000, 10.0092), (12000, 10.0115), (16000, 10.0185)):
        overruns.add(pace.late_s(t_us, now_s))
    assert overruns.text() == "2 of 4 steps more than 1 ms late, the worst by 2.5 ms"
