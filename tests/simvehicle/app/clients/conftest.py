"""A simulated vehicle in a thread, for clients that connect over UDP."""

import io
import queue
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from mavproxy_fault.links.spec import open_link
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import FreeLoop
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation

SCENARIO = """
vehicle: {kind: multirotor, parameters: iris}
sensors: {imu: {rate_hz: 100}, gps: {preset: ideal, rate_hz: 5}}
"""
SPEED = 8.0  # times real time; a client's timeouts use wall time


class Flown:
    """The vehicle, and the loopback UDP port that it sends to."""

    def __init__(self, simulation: Simulation, loop: FreeLoop, port: int) -> None:
        self.simulation = simulation
        self.loop = loop
        self.port = port


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


@pytest.fixture(params=[SCENARIO])
def flown(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Flown]:
    """A multirotor at home, simulated at several times real time until the test ends."""
    path = tmp_path / "quad.yaml"
    path.write_text(request.param)
    port = free_port()
    simulation = Simulation(read_scenario(path))
    stop = threading.Event()
    with closing(open_link(f"udpout:127.0.0.1:{port}")) as link:
        loop = FreeLoop(simulation, None, [link], SPEED, Progress(0.0, io.StringIO()))
        loop.step()

        def fly() -> None:
            while not stop.is_set():
                loop.run(loop.t_us + 100_000)

        thread = threading.Thread(target=fly)
        thread.start()
        try:
            yield Flown(simulation, loop, port)
        finally:
            stop.set()
            thread.join(20)


Until = Callable[..., Any]


@pytest.fixture
def until() -> Until:
    """Wait for a subscription to bring a value that satisfies a condition."""

    def wait(
        subscribe: Callable[[Callable[..., None]], Any],
        holds: Callable[[Any], bool],
        timeout_s: float = 60.0,
    ) -> Any:
        values: queue.Queue[Any] = queue.Queue()
        subscribe(lambda value, *_: values.put(value))
        while True:
            value = values.get(timeout=timeout_s)
            if holds(value):
                return value

    return wait
