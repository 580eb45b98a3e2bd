"""The page in a real browser, against a real engine on a real bus."""

import select
import shutil
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from analysis.publish import Publisher
from analysis.results import AttitudeError, Decision
from analysis.web.server import serve
from mavproxy_fault.control import Control
from mavproxy_fault.engine import Engine
from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.live import Live
from mavproxy_fault.schedule import Schedule

CHROMIUM = shutil.which("chromium")
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
SATELLITES = ("E05", "E09", "G07", "G12", "G25", "G31")
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="Debian's chromium is not installed")


class Loop:
    """A proxy's loop that does nothing but live control."""

    def __init__(self, url: str = "tcp/127.0.0.1:0") -> None:
        self.bus: Bus = open_bus(url, run="flight-1", router=True)
        self.engine = Engine(Schedule(1))
        self.engine.start_at(1_000_000)
        self.live = Live(Control(self.engine), lambda: 5_000_000)
        self.live.offer(self.bus)
        self.publisher = Publisher(self.bus)
        self._stop, self._stopped = socket.socketpair()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self._stopped, *self.live.filenos()], (), ())
            if self._stopped in ready:
                return
            self.live.serve()
            self.live.publish({}, self.engine.take_labels())

    def epoch(self, t_s: float, excluded: tuple[str, ...] = ()) -> None:
        """Publish what a monitor says of one epoch."""
        large = 60.0 if excluded else 0.0
        t_us = round(t_s * 1e6)
        decision = Decision(
            t_s=t_s, t_us=t_us, statistic=4.0 + t_s % 2 + large, threshold=16.8, dof=6, p_value=0.5,
            alarm=bool(excluded), hypothesis="satellites" if excluded else "none",
            excluded=excluded, satellites=SATELLITES, residual_m=(1.0,) * 6,
            normalised=tuple(7.4 if name in excluded else 0.8 for name in SATELLITES),
        )  # fmt: skip
        error = AttitudeError(
            t_s=t_s, t_us=t_us, estimator="ekf", roll=0.1, pitch=0.1, yaw=0.3, angle=0.3 + t_s % 1
        )
        self.publisher.publish([decision, error])

    def close(self) -> None:
        """End the loop and the bus, as a proxy that is stopped does."""
        self._stop.send(b"!")
        self._thread.join()
        self.live.close()
        self._stop.close()
        self._stopped.close()


@pytest.fixture
def loop() -> Iterator[Loop]:
    running = Loop()
    yield running
    running.close()


@pytest.fixture
def address(loop: Loop) -> Iterator[str]:
    with serve(loop.bus.url, port=0) as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser: Any, address: str) -> Iterator[Any]:
    found = browser.new_page(viewport={"width": 1360, "height": 900})
    complaints: list[str] = []
    found.on("console", lambda said: said.type == "error" and complaints.append(said.text))
    found.on("pageerror", lambda error: complaints.append(str(error)))
    found.complaints = complaints
    found.goto(address)
    found.wait_for_selector("#connection.there")
    found.wait_for_selector("#kind option", state="attached")
    yield found
    found.close()


@pytest.mark.browser
@needs_browser
def test_clicking_arms_a_fault_on_the_proxy_and_disarms_it(page: Any, loop: Loop) -> None:
    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "HIL_SENSOR.xgyro")
    page.fill("[data-key=value]", "0.1")
    page.wait_for_selector("#preview canvas")
    page.click("#arm")
    page.wait_for_selector("#faults li.active")
    (fault,) = loop.engine.state()["faults"]
    assert (fault["id"], fault["parameters"]) == ("bias", {"value": 0.1})
    page.click("#faults button")
    page.wait_for_selector("#faults li", state="detached")
    assert loop.engine.ids() == []
    assert page.complaints == []


@pytest.mark.browser
@needs_browser
def test_an_isolated_satellite_is_marked_and_listed(page: Any, loop: Loop) -> None:
    for step in range(10):
        loop.epoch(10 + step / 5)
    loop.epoch(12.0, excluded=("G12",))
    page.wait_for_selector(".sat.out")
    assert page.text_content(".sat.out").startswith("G12")
    assert "satellites, isolated: G12" in page.text_content("#events")
    page.wait_for_selector("#statistic canvas")
    assert page.complaints == []


@pytest.mark.browser
@needs_browser
def test_a_schedule_is_saved_loaded_and_a_wrong_one_explained(
    page: Any, loop: Loop, tmp_path: Path
) -> None:
    good, wrong = tmp_path / "good.yaml", tmp_path / "wrong.yaml"
    good.write_text("faults:\n- {id: still, fault: freeze, target: HIL_SENSOR.zacc}\n")
    wrong.write_text("faults:\n- {id: still, fault: freeez, target: HIL_SENSOR.zacc}\n")
    page.set_input_files("#load", good)
    page.wait_for_selector("#schedule-said.fine")
    page.set_input_files("#load", wrong)
    page.wait_for_selector("#schedule-said:not(.fine)")
    assert "freeez is unknown" in page.text_content("#schedule-said")
    assert loop.engine.ids() == ["still"]
    with page.expect_download() as saved:
        page.click("#save")
    assert "id: still" in Path(saved.value.path()).read_text()


@pytest.mark.browser
@needs_browser
def test_a_second_viewer_without_the_token_sees_the_same_and_can_change_nothing(
    browser: Any, page: Any, address: str
) -> None:
    page.select_option("#kind", "preset:gyro-bias")
    page.click("#arm")
    second = browser.new_page()
    second.goto(address.partition("#")[0])
    second.wait_for_selector("#faults li.active")
    assert second.is_visible("#viewing")
    assert all(one.is_disabled() for one in second.query_selector_all("main button:not(#csv)"))
    second.close()


def status_of(address: str, headers: dict[str, str]) -> int:
    origin = address.partition("/#")[0]
    url = f"{origin}/api/ctl/schedule/stop"
    request = urllib.request.Request(url, data=b"", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as reply:
            return int(reply.status)
    except urllib.error.HTTPError as error:
        with error:
            return error.code


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"X-Token": "guessed"},
        {"X-Token": "TOKEN", "Origin": "http://elsewhere.example"},
        {"X-Token": "TOKEN", "Host": "rebound.example:8350"},
    ],
)
def test_what_comes_without_the_token_or_from_elsewhere_is_refused(
    address: str, headers: dict[str, str]
) -> None:
    token = address.partition("token=")[2]
    given = {key: value.replace("TOKEN", token) for key, value in headers.items()}
    assert status_of(address, given) == 403
