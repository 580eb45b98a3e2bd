"""A small proxy that runs, the page over it, and Debian's Chromium to look at it with."""

import math
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from analysis.monitor.publish import Publisher
from analysis.results import AttitudeError, Decision, SensorDecision
from analysis.web.page_server import serve_page
from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.statistics import link_statistics
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import Label

LINKS = (LinkRole("simulator", "to-vehicle"), LinkRole("vehicle", "from-vehicle"))
STEP_US = 20_000
TRUE = {"attitude_quaternion": (1.0, 0.0, 0.0, 0.0), "rollspeed": 0.5, "lat": 474_000_000}
SATELLITES = ("E05", "E09", "G07", "G12", "G25", "G31")


class Loop:
    """A proxy between a simulator at 50 Hz and a vehicle, without links: only live control."""

    def __init__(self, url: str = "tcp/127.0.0.1:0") -> None:
        self.bus: Bus = open_bus(url, run="flight-1", router=True)
        control = LiveControl(Engine(Schedule(1)))
        self.core = Core(LINKS, control.engine, control=control)
        self.engine = control.engine
        self.live = LiveSession(control, lambda: self.core.clock.t_us)
        self.live.offer(self.bus)
        self.publisher = Publisher(self.bus)
        self.labels: list[Label] = []
        self.commands: list[tuple[int, float]] = []  # that the vehicle was given, with param7
        self.xgyro = 0.0  # as the vehicle was sent it last
        self.steps_left = math.inf  # at nought the vehicle's time stands, however slow a page is
        # Why nothing is recorded, and what is missing; published again and again as by a proxy, as
        # the bus may lose a sample.
        self.recording: tuple[str | None, int] = (None, 0)
        self._t_us = 1_000_000
        self._seq = 0
        self._stop, self._stopped = socket.socketpair()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while True:
            waited = [self._stopped, *self.live.filenos()]
            ready, _, _ = select.select(waited, (), (), STEP_US * 1e-6)
            if self._stopped in ready:
                return
            if not ready and self.steps_left > 0:
                self.steps_left -= 1
                self._step()
            self.live.serve()
            labels = self.core.drain_labels()
            self.labels += labels
            figures_now = [link_statistics(self.core, number) for number in range(len(LINKS))]
            self.live.publish(figures_now, labels)
            self.live.publish_recording(*self.recording)
            self.live.show(time.monotonic())

    def _step(self) -> None:
        self._t_us += STEP_US
        stamp = {"time_usec": self._t_us}
        frames = [
            ("HIL_SENSOR", {**stamp, "xgyro": 0.5}),
            ("HIL_STATE_QUATERNION", {**stamp, **TRUE}),
            ("ESTIMATOR_STATUS", {**stamp, "flags": 0x2F, "vel_ratio": 0.2, "mag_ratio": 1.5}),
            ("GLOBAL_POSITION_INT", {"lat": TRUE["lat"]}),
            ("HEARTBEAT", {"autopilot": 12, "base_mode": 129, "system_status": 4}),
        ]
        for name, values in frames:
            self._seq = (self._seq + 1) & 0xFF
            raw = build_frame(message_layout(name), values, seq=self._seq)
            for link, sent, _ in list(self.core.received(0, raw, self._t_us)):
                frame = Frame(sent, message_layout(int.from_bytes(sent[7:10], "little")))
                if frame.layout.name == "COMMAND_LONG" and link == 0:
                    self._grant(frame)
                elif frame.layout.name == "HIL_SENSOR":
                    self.xgyro = round(float(frame.number("xgyro")), 6)

    def _grant(self, command: Frame) -> None:
        """Answer a command as a vehicle that accepts every command."""
        number = int(command.number("command"))
        self.commands.append((number, command.number("param7")))
        raw = build_frame(message_layout("COMMAND_ACK"), {"command": number})
        self.core.received(0, raw, self._t_us)

    @property
    def now_s(self) -> float:
        """The vehicle's time."""
        return self._t_us / 1e6

    def epoch(self, t_s: float, excluded: tuple[str, ...] = ()) -> None:
        """Publish what a monitor says of one epoch."""
        large = 60.0 if excluded else 0.0
        t_us = round(t_s * 1e6)
        decision = Decision(
            t_us=t_us, statistic=4.0 + t_s % 2 + large, threshold=16.8, dof=6, p_value=0.5,
            alarm=bool(excluded), hypothesis="satellites" if excluded else "none",
            excluded=excluded, satellites=SATELLITES, residual_m=(1.0,) * 6,
            normalised=tuple(7.4 if name in excluded else 0.8 for name in SATELLITES),
        )  # fmt: skip
        error = AttitudeError(
            t_us=t_us, estimator="ekf", roll=0.1, pitch=0.1, yaw=0.3, angle=0.3 + t_s % 1
        )
        self.publisher.publish([decision, error])

    def sensor(
        self, t_s: float, name: str, statistic: float | None = None, *, bad: bool = False
    ) -> None:
        """Publish what a monitor says of one sensor; with a threshold of ten where it tests it."""
        tested = statistic is not None
        decision = SensorDecision(
            t_us=round(t_s * 1e6), sensor=name, statistic=statistic,
            threshold=10.0 if tested else None, dof=3 if tested else 0, alarm=bad, isolated=bad,
        )  # fmt: skip
        self.publisher.publish([decision])

    def close(self) -> None:
        """End the loop and the bus, as a proxy that is stopped does."""
        self._stop.send(b"!")
        self._thread.join()
        self.live.close()
        self._stop.close()
        self._stopped.close()


@pytest.fixture
def new_loop() -> Callable[..., Loop]:
    return Loop


@pytest.fixture
def loop() -> Iterator[Loop]:
    running = Loop()
    yield running
    running.close()


@pytest.fixture
def address(loop: Loop) -> Iterator[str]:
    with serve_page(loop.bus.url, port=0) as found:
        yield found


def open_with_complaints(browser: Any, address: str) -> Any:
    """Open an address in a page that notes in `complaints` what the browser finds wrong."""
    found = browser.new_page(viewport={"width": 1360, "height": 900})
    found.set_default_timeout(200_000)  # kernels may have to be compiled first
    complaints: list[str] = []
    found.on("console", lambda said: said.type == "error" and complaints.append(said.text))
    found.on("pageerror", lambda error: complaints.append(str(error)))
    found.complaints = complaints
    found.goto(address)
    wait_until_ready(found)
    return found


def wait_until_ready(page: Any) -> None:
    """Wait for the stream subscribed last: what is published from now on is heard on all."""
    page.wait_for_selector("#connection.there")
    page.wait_for_selector("#links-title:not([hidden])")
    page.wait_for_selector("#kind option", state="attached")


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[[str], Any]]:
    """Opens addresses as `open_with_complaints`, and closes the pages."""
    opened: list[Any] = []

    def show(address: str) -> Any:
        opened.append(open_with_complaints(browser, address))
        return opened[-1]

    yield show
    for found in opened:
        found.close()


@pytest.fixture(scope="module")
def shared_page(browser: Any) -> Iterator[Any]:
    """A page over a proxy whose vehicle stands still in time."""
    running = Loop()
    with serve_page(running.bus.url, port=0) as address:
        found = open_with_complaints(browser, address)
        running.steps_left = 0
        yield found
        found.close()
    running.close()


@pytest.fixture
def still_page(shared_page: Any) -> Any:
    """The page that tests share which only call its own functions, loaded anew for each."""
    shared_page.complaints.clear()
    shared_page.reload()
    wait_until_ready(shared_page)
    return shared_page


@pytest.fixture
def page(address: str, open_page: Callable[[str], Any]) -> Any:
    return open_page(address)
