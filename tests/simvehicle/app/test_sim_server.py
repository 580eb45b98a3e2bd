"""`sim` from its command line, and its loops on loopback links."""

import argparse
import io
import math
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.udp import UdpServer
from simvehicle.app import sim_server as server
from simvehicle.app.pace import Pace
from simvehicle.app.sim_progress import Progress
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation

SCENARIO = """
duration_s: 2.0
start: {height_m: 100.0}
vehicle: {kind: fixedwing, parameters: aerosonde-2025}
sensors: {imu: {rate_hz: 250}}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SCENARIO)
    return path


def received(link: UdpServer) -> list[dialect.MAVLink_message]:
    data = b"".join(chunk for _, chunk in link.read())
    return dialect.MAVLink(None).parse_buffer(data) or []


Loop = Callable[..., tuple[server.FreeLoop, UdpServer]]


@pytest.fixture
def free_loop(scenario: Path) -> Iterator[Loop]:
    """Create a loop for the scenario and the remote end of its link."""
    with ExitStack() as links:

        def make(*, hil: bool = False, gcs: bool = False) -> tuple[server.FreeLoop, UdpServer]:
            far = links.enter_context(closing(open_link("udpin:127.0.0.1:0")))
            assert isinstance(far, UdpServer)
            near = links.enter_context(closing(open_link(f"udpout:127.0.0.1:{far.port}")))
            simulation = Simulation(read_scenario(scenario))
            progress = Progress(0.0, io.StringIO())
            loop = server.FreeLoop(
                simulation, near if hil else None, [near] * gcs, math.inf, progress
            )
            return loop, far

        yield make


def test_without_links_the_scenario_is_flown_to_its_end(
    scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sim", str(scenario), "--speed", "max"]) == 0
    assert "2.0 s simulated" in capsys.readouterr().err


def test_hil_frames_are_published_step_by_step(free_loop: Loop) -> None:
    loop, far = free_loop(hil=True)
    for _ in range(20):
        loop.step()
    names = [m.get_type() for m in received(far)]
    assert names.count("HIL_SENSOR") == 20
    assert names.count("HIL_STATE_QUATERNION") == 20


def test_two_flights_of_one_seed_send_the_same_bytes(free_loop: Loop) -> None:
    sent = []
    for _ in range(2):
        loop, far = free_loop(hil=True)
        for _ in range(50):
            loop.step()
        sent.append(b"".join(chunk for _, chunk in far.read()))
    assert sent[0] == sent[1]
    assert len(sent[0]) > 5000


def test_a_ground_station_sees_a_vehicle_that_starts_in_the_air_hold_its_height(
    free_loop: Loop,
) -> None:
    loop, far = free_loop(gcs=True)
    for _ in range(2500):
        loop.step()
        if loop.t_us % 2_000_000 == 0:
            messages = received(far)
    last = {m.get_type(): m for m in messages}
    assert last["GLOBAL_POSITION_INT"].relative_alt == pytest.approx(100_000, abs=8_000)
    assert last["EXTENDED_SYS_STATE"].landed_state == dialect.MAV_LANDED_STATE_IN_AIR


def test_every_ground_station_sees_the_vehicle_and_may_command_it(scenario: Path) -> None:
    with ExitStack() as links:
        ends = [links.enter_context(closing(open_link("udpin:127.0.0.1:0"))) for _ in range(2)]
        near = [
            links.enter_context(closing(open_link(end.name.replace("in", "out", 1))))
            for end in ends
        ]
        simulation = Simulation(read_scenario(scenario))
        progress = Progress(0.0, io.StringIO())
        loop = server.FreeLoop(simulation, None, near, math.inf, progress)
        loop.step()
        for end in ends:
            assert isinstance(end, UdpServer)
            assert "HEARTBEAT" in [m.get_type() for m in received(end)]
            request = dialect.MAVLink_command_long_message(1, 1, 520, 0, 1, 0, 0, 0, 0, 0, 0)
            end.write(request.pack(dialect.MAVLink(None, srcSystem=255)))
            answers: list[str] = []
            while "COMMAND_ACK" not in answers:
                loop.step()
                answers = [m.get_type() for m in received(end)]


def test_datagrams_have_complete_frames_and_fit_an_ethernet_frame() -> None:
    frames = [bytes([i]) * 300 for i in range(10)]
    chunks = server.join_datagrams(frames)
    assert b"".join(chunks) == b"".join(frames)
    assert [len(c) for c in chunks] == [1200, 1200, 600]


def test_a_ground_station_link_with_an_autopilot_link_is_refused(
    scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--hil", "tcpin:127.0.0.1:0", "--gcs", "udpout:127.0.0.1:14550"]
    assert main(["sim", str(scenario), *arguments]) == 2
    assert "--gcs: udpout:127.0.0.1:14550 cannot be combined with" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--speed", "fast"], "--speed: fast is not a speed"),
        (["--hil", "tcpin:127.0.0.1"], "has no HOST:PORT"),
        (["no_such.yaml"], "no_such.yaml: cannot be read"),
    ],
)
def test_invalid_input_is_reported_with_exit_code_2(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sim", *arguments]) == 2
    assert text in capsys.readouterr().err


def test_more_sensors_than_px4_accepts_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "many.yaml"
    path.write_text("sensors: {imu: [{}, {}, {}], mag: [{}, {}, {}]}")
    assert main(["sim", str(path), "--hil", "tcpin:127.0.0.1:0"]) == 2
    assert "sensors.mag: 3 are too many for a HIL link; use at most 2" in capsys.readouterr().err


def test_the_pace_does_not_change_the_bytes_sent(free_loop: Loop) -> None:
    sent = []
    for speed in (math.inf, 200.0):
        loop, far = free_loop(hil=True)
        loop._pace = Pace(speed)
        loop.run(100_000)
        sent.append(b"".join(chunk for _, chunk in far.read()))
    assert sent[0] == sent[1]


def test_an_interrupt_ends_the_flight_with_a_summary(
    scenario: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = 0

    def step(loop: server.FreeLoop) -> None:
        nonlocal steps
        steps += 1
        if steps == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(server.FreeLoop, "step", step)
    args = argparse.Namespace(
        scenario=str(scenario), hil=None, gcs=[], real_time=False, speed="1", seed=None, plot=None
    )
    assert server.main(args) == 0
    assert "stopped" in capsys.readouterr().err


def test_a_diverging_vehicle_is_reported(free_loop: Loop) -> None:
    loop, _ = free_loop()
    loop._simulation._x[3] = math.nan

    with pytest.raises(ConfigError, match="simulation diverged at"):
        loop.step()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_flight_started_in_the_background_ends_with_its_summary(
    scenario: Path, number: signal.Signals
) -> None:
    with closing(open_link("udpin:127.0.0.1:0")) as far:
        assert isinstance(far, UdpServer)
        command = f"-m mavproxy_fault.cli sim {scenario} --gcs udpout:127.0.0.1:{far.port}"
        process = subprocess.Popen(
            # As a shell without job control starts a background command (`&`).
            ["sh", "-c", f"trap '' INT; exec {sys.executable} {command}"],
            stderr=subprocess.PIPE,
            text=True,
        )
        select.select(far.filenos(), (), (), 200)
        process.send_signal(number)
        _, text = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "times real time" in text.splitlines()[-1]
