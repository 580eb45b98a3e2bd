"""The entire command over real sockets, between a simulator here and a recorded ArduCopter."""

import contextlib
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from mavproxy_fault.ardupilot.bridge_command import BridgeLoop, FlightEndError
from mavproxy_fault.ardupilot.bridged_autopilot import BridgedAutopilot
from mavproxy_fault.ardupilot.fed_autopilot import FedAutopilot
from mavproxy_fault.ardupilot.hil_readings import Readings, TrueState
from mavproxy_fault.ardupilot.sensor_discovery import DiscoveredVehicle
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.links.udp import UdpServer
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser

STAND_IN = Path(__file__).with_name("recorded_autopilot.py")
STEP_US = 2_500
PATIENCE_S = 30.0


class Simulator:
    """Steps as a HIL simulator sends them, and the replies."""

    def __init__(self, inbox: Inbox, *, gps: bool = True) -> None:
        self.t_us = 0
        self.answers: list[Frame] = []
        self.others: list[Frame] = []
        self._inbox, self._gps = inbox, gps

    def step(self) -> None:
        self.t_us += STEP_US
        truth = {"time_usec": self.t_us, "attitude_quaternion": (1, 0, 0, 0), "lat": 474_000_000}
        sensor = {"time_usec": self.t_us, "zacc": -9.8, "abs_pressure": 955}
        frames = [
            build_frame(message_layout("HIL_SENSOR"), {**sensor, "fields_updated": 0x1FFF}),
            build_frame(message_layout("HIL_STATE_QUATERNION"), truth),
        ]
        if self._gps and self.t_us % 200_000 == 0:
            fix = {"time_usec": self.t_us, "fix_type": 3, "lat": 474_000_000}
            frames.insert(1, build_frame(message_layout("HIL_GPS"), fix))
        self._inbox.link.write(b"".join(frames))
        self.listen(0.0)

    def listen(self, wait_s: float) -> None:
        select.select(self._inbox.link.filenos(), [], [], wait_s)
        for frame in self._inbox.frames():
            mine = frame.layout.name == "HIL_ACTUATOR_CONTROLS"
            (self.answers if mine else self.others).append(frame)


@contextmanager
def bridge(
    folder: Path, *words: str, gps: bool = True
) -> Iterator[tuple[Simulator, "subprocess.Popen[str]"]]:
    with closing(TcpServer("127.0.0.1", 0)) as link:
        command = [sys.executable, "-m", "mavproxy_fault.cli", "ardupilot"]
        command += ["--hil", f"tcp:127.0.0.1:{link.port}", "--out", str(folder)]
        stand_in = " ".join([sys.executable, str(STAND_IN), *words])
        process = subprocess.Popen(
            [*command, "--binary", stand_in], stderr=subprocess.PIPE, text=True
        )
        simulator = Simulator(Inbox(link), gps=gps)
        deadline_s = time.monotonic() + PATIENCE_S
        while not simulator.others and time.monotonic() < deadline_s:
            simulator.listen(0.1)  # the bridge sends first
        try:
            yield simulator, process
        finally:
            process.terminate()
            process.communicate()


def fly(simulator, until):
    """Step; after the first answer, each step waits for its own for a while."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not until() and time.monotonic() < deadline_s:
        answered = len(simulator.answers)
        simulator.step()
        wait_s = 0.2 if answered else 0.005 if simulator.t_us > 1_100_000 else 0.0
        if len(simulator.answers) == answered:
            simulator.listen(wait_s)
    assert until()


def test_each_step_is_answered_with_its_stamp_and_the_motors_of_the_recording(tmp_path):
    with bridge(tmp_path) as (simulator, process):
        fly(simulator, lambda: len(simulator.answers) >= 115)
        stamps = [frame.number("time_usec") for frame in simulator.answers]
        assert stamps == sorted(set(stamps))
        last = simulator.answers[-1]
        assert all(last.number("controls", motor) > 0.6 for motor in range(4))
        assert simulator.answers[0].number("controls", 0) == 0.0
        fly(simulator, lambda: process.poll() is not None)
    texts = {frame.layout.name for frame in simulator.others}
    assert {"HEARTBEAT", "PARAM_VALUE", "COMMAND_ACK", "STATUSTEXT"} <= texts


def test_the_parameters_of_the_autopilot_are_stored_in_the_folder(tmp_path):
    with bridge(tmp_path) as (simulator, _):
        fly(simulator, lambda: bool(simulator.answers))
    parameters = (tmp_path / "bridge.parm").read_text().splitlines()
    assert "AHRS_EKF_TYPE 3" in parameters
    assert "SIM_RATE_HZ 400" in parameters


def test_the_death_of_the_autopilot_is_reported_with_its_time(tmp_path):
    with bridge(tmp_path, "--ends-after", "30") as (simulator, process):
        fly(simulator, lambda: process.poll() is not None)
        said = process.stderr.read()
        assert process.returncode == 1
    assert "the autopilot process ended with exit code 3" in said
    assert "s of vehicle time" in said


def test_a_simulator_without_gps_is_refused_before_the_autopilot_starts(tmp_path):
    with bridge(tmp_path, gps=False) as (simulator, process):
        fly(simulator, lambda: process.poll() is not None)
        said = process.stderr.read()
        assert process.returncode == 2
    assert "no HIL_GPS was received; ArduPilot needs a GPS of id 0" in said
    assert not (tmp_path / "autopilot.log").exists()


def test_a_missing_binary_is_reported_with_the_remedy(tmp_path):
    command = [sys.executable, "-m", "mavproxy_fault.cli", "ardupilot", "--out", str(tmp_path)]
    done = subprocess.run(
        [*command, "--binary", "no-such-arducopter"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "'no-such-arducopter' is not a program; give ArduPilot's SITL binary" in done.stderr


@pytest.mark.parametrize("line", ["AHRS_EKF_TYPE 10", "SIM_BARO_COUNT 1"])
def test_parameters_that_pass_the_truth_to_the_estimator_are_refused(tmp_path, line):
    own = tmp_path / "own.parm"
    own.write_text(line + "\n")
    command = [sys.executable, "-m", "mavproxy_fault.cli", "ardupilot", "--out", str(tmp_path)]
    done = subprocess.run(
        [*command, "--binary", sys.executable, "--parameters", str(own)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert f"--parameters: {line.split()[0]} = " in done.stderr


def test_a_simulator_that_falls_silent_behind_a_proxy_is_reported_once():
    messages = []

    class Autopilot:
        """An autopilot that has started, and ends after the first status line."""

        started, armed, steps, t_us = True, False, 0, 0

        def filenos(self):
            return quiet.filenos()

        def read(self):
            return []

        def poll(self):
            return 0 if messages else None

    with closing(TcpServer("127.0.0.1", 0)) as link, contextlib.ExitStack() as stack:
        peer = stack.enter_context(socket.create_connection(("127.0.0.1", link.port)))
        quiet = stack.enter_context(closing(UdpServer("127.0.0.1", 0)))
        while not link.peer_count:
            link.read()
        exchange = BridgeLoop(link, Autopilot(), messages.append, silence_s=0.1)
        with pytest.raises(FlightEndError, match="ended with exit code 0"):
            exchange.run(b"")
        assert peer.fileno() >= 0
    assert messages == [f"{link.name}: no step for 0.1 s; still waiting"]


def test_sitl_is_told_the_battery_and_the_loss_of_the_remote_control(tmp_path, monkeypatch):
    home = TrueState(0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, (0.0, 0.0, 0.0))
    bridge, written = BridgedAutopilot(["true"], "copter", tmp_path, {}, print), list[bytes]()
    monkeypatch.setattr(bridge._mavlink, "write", written.append)
    found = DiscoveredVehicle(Readings(), home, 400.0, frozenset())
    FedAutopilot._start(bridge, found)  # without a process

    def receive(name, **values):
        layout = message_layout(name)
        bridge.receive(Frame(build_frame(layout, values), layout))

    receive("HIL_SENSOR", fields_updated=0x1FFF)
    receive("BATTERY_STATUS", voltages=(12_500, *(0xFFFF,) * 9))
    for t_us in range(0, 2_000_000, 100_000):
        if t_us < 600_000 or t_us > 1_500_000:
            receive("RC_CHANNELS", chancount=8)
        receive("HIL_STATE_QUATERNION", time_usec=t_us, attitude_quaternion=(1, 0, 0, 0))
    sent = [
        (frame.read("param_id").rstrip(b"\0"), frame.number("param_value"))
        for frame in Parser().push(b"".join(written))
        if frame.layout.name == "PARAM_SET"
    ]
    bridge.close()
    lost_and_found = [(b"SIM_RC_FAIL", 1.0), (b"SIM_RC_FAIL", 0.0)]
    assert sent == [(b"SIM_BATT_VOLTAGE", 12.5), *lost_and_found]


def test_within_a_process_it_is_a_link_that_ends_with_its_autopilot(tmp_path):
    messages: list[str] = []
    words = [sys.executable, str(STAND_IN)]
    with closing(BridgedAutopilot(words, "copter", tmp_path, {}, messages.append)) as autopilot:
        simulator = Simulator(Inbox(autopilot))
        assert autopilot.peer_count == 1
        fly(simulator, lambda: len(simulator.answers) >= 115)
        assert simulator.answers[-1].number("controls", 0) > 0.6
        fly(simulator, lambda: autopilot.peer_count == 0)
        assert autopilot.poll() == 3
    assert messages[0] == f"{sys.executable}: starting in {tmp_path} at 400 steps/s"


def test_within_a_process_a_vehicle_without_gps_is_refused(tmp_path):
    with closing(BridgedAutopilot(["true"], "copter", tmp_path, {}, print)) as autopilot:
        simulator = Simulator(Inbox(autopilot), gps=False)
        with pytest.raises(ConfigError, match="the HIL link: no HIL_GPS was received"):
            fly(simulator, lambda: False)
        assert autopilot.poll() is None
    assert not (tmp_path / "autopilot.log").exists()
