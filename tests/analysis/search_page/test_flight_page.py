"""The search's page: who may fly and save, and what is seen of it in a real browser."""

import contextlib
import json
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from analysis.search.search_session import SearchSession
from analysis.search.space.fault_range import FaultRange
from analysis.search.space.test_file import InitialState, TestFile
from analysis.search_page.flight_routes import FlightPage
from analysis.search_page.flights import Flights
from analysis.search_page.search_server import make_flights
from analysis.web.page_server import access_for, make_server, open_socket, serve_in_thread
from mavproxy_fault.documents.errors import ConfigError

TEST = TestFile(
    duration_s=2.0,
    initial=InitialState(roll_deg=(-30.0, 30.0)),
    faults=[FaultRange(fault="bias", target="HIL_SENSOR.xgyro", value=(0.1, 0.3), at_s=0.5)],
)


@contextlib.contextmanager
def serve_search_page(flights: Flights) -> Iterator[str]:
    """Serve the page on a free port; yields the address to open."""
    bound = open_socket(0)
    access, address = access_for(bound)
    with serve_in_thread(make_server(FlightPage(flights, access).app), bound):
        yield address


class HeldSession(SearchSession):
    """A session whose flights wait until they may go on."""

    def __init__(self, test: TestFile, folder: Path) -> None:
        super().__init__(test, folder)
        self.go_on = threading.Event()

    def next(self) -> Any:
        self.go_on.wait(60.0)
        return super().next()


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    with serve_search_page(make_flights(TEST, tmp_path / "found")) as found:
        yield found


def asked(
    address: str, what: str, headers: dict[str, str], data: bytes | None = b""
) -> tuple[int, Any]:
    """Status and answer of a change; of a look where there are no data."""
    url = f"{address.partition('/#')[0]}/api/{what}"
    request = urllib.request.Request(url, data=data, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=60) as reply:
            return reply.status, json.loads(reply.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read())


def token_of(address: str) -> dict[str, str]:
    return {"X-Token": address.partition("token=")[2]}


def test_reading_is_open_and_flying_needs_the_token(address: str) -> None:
    assert asked(address, "state", {}, None)[0] == 200
    assert asked(address, "state", {"Host": "elsewhere.example"}, None)[0] == 403
    for what in ("next", "save"):
        status, answer = asked(address, what, {"X-Token": "guessed"})
        assert status == 403
        assert "the token is wrong" in answer["error"]


def test_the_page_responds_while_a_test_is_in_flight(tmp_path: Path) -> None:
    session = HeldSession(TEST, tmp_path)
    with serve_search_page(Flights(session)) as address:
        try:
            state = {"number": None, "flying": True, "failed": False}
            assert asked(address, "state", {}, None) == (200, state)
            assert asked(address, "flight", {}, None) == (200, None)
            for what in ("next", "save"):
                status, answer = asked(address, what, token_of(address))
                assert status == 400
                assert answer["error"] == "a test is in flight; wait until it ends"
        finally:
            session.go_on.set()


def test_a_test_for_the_simulator_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--interactive: shows only compiled flights"):
        make_flights(TestFile(estimator="fusion"), tmp_path)


def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "found").write_text("in the way")
    flights = make_flights(TEST, tmp_path / "found")
    flights.next()
    flights.close()
    with pytest.raises(
        ConfigError, match=r"found: cannot be written: .* another folder with --out"
    ):
        flights.save()


class BrokenSession(SearchSession):
    """A session whose second flight fails, as by a mistake of ours."""

    def next(self) -> Any:
        if self.number == 0:
            raise RuntimeError("a mistake of ours")
        return super().next()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_flight_that_fails_is_reported_and_saves_nothing(tmp_path: Path) -> None:
    flights = Flights(BrokenSession(TEST, tmp_path / "found"))
    for _ in range(2):
        flights.next()
        flights.close()
    assert json.loads(flights.state()) == {"number": 0, "flying": False, "failed": True}
    with pytest.raises(ConfigError, match="no test is displayed; fly one first"):
        flights.save()
    assert not (tmp_path / "found").exists()


@pytest.fixture
def page(browser: Any, address: str) -> Iterator[Any]:
    found = browser.new_page(viewport={"width": 1360, "height": 900})
    found.set_default_timeout(200_000)  # kernels may have to be compiled first
    complaints: list[str] = []
    found.on("console", lambda said: said.type == "error" and complaints.append(said.text))
    found.on("pageerror", lambda error: complaints.append(str(error)))
    found.goto(address)
    found.wait_for_selector("#title:has-text('test 0:')")
    yield found
    assert complaints == []
    found.close()


@pytest.mark.browser
def test_nobody_is_kept_from_the_page(page: Any, find_barriers: Callable[[Any], list[str]]) -> None:
    assert find_barriers(page) == []


@pytest.mark.browser
def test_the_next_test_is_flown_shown_and_saved(page: Any, tmp_path: Path) -> None:
    first = page.text_content("#values")
    page.click("#next:not([disabled])")
    page.wait_for_selector("#title:has-text('test 1:')")
    assert "worst so far" in page.text_content("#title")
    assert page.text_content("#values") != first
    assert "bias on HIL_SENSOR.xgyro from 0.50 s on" in page.text_content("#acting")
    page.click("#save:not([disabled])")
    page.wait_for_selector("#message:has-text('saved:')")
    files = [tmp_path / "found" / f"test-0001.{kind}" for kind in ("csv", "yaml")]
    assert page.text_content("#message").splitlines()[1:] == [str(one) for one in files]
    assert all(one.is_file() for one in files)


@pytest.mark.browser
def test_an_animation_flies_the_aircraft_to_the_end(page: Any) -> None:
    picture = "document.getElementById('space').toDataURL()"
    before = page.evaluate(picture)
    page.click("#animate")
    page.wait_for_selector("#animate:has-text('Animate')")
    assert page.text_content("#instant") == "2.00 s"
    assert float(page.input_value("#time")) == 2.0
    assert page.evaluate(picture) != before


@pytest.mark.browser
def test_all_plots_share_the_zoom_and_the_instant(page: Any) -> None:
    box = page.locator("#plots .u-over").first.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] * 0.25, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.75, middle, steps=5)
    page.mouse.up()
    ranges = "plots.map(({ plot }) => [plot.scales.x.min, plot.scales.x.max])"
    page.wait_for_function(f"() => {ranges}[5][0] > 0.4")
    found = page.evaluate(ranges)
    assert len(found) == 6
    for low, high in found:
        assert (low, high) == pytest.approx((0.5, 1.5), abs=0.05)
    page.focus("#time")
    page.keyboard.press("Home")
    assert page.text_content("#instant") == "0.01 s"
    assert page.locator(".instant:visible").count() == 0  # outside of what is shown


@pytest.mark.browser
def test_a_viewer_without_the_token_sees_and_cannot_fly(browser: Any, address: str) -> None:
    viewer = browser.new_page()
    viewer.goto(address.partition("#")[0])
    viewer.wait_for_selector("#title:has-text('test 0:')")
    assert viewer.is_visible("#viewing")
    assert viewer.is_disabled("#next")
    assert viewer.is_disabled("#save")
    assert viewer.is_enabled("#animate")
    viewer.close()


@pytest.mark.browser
def test_a_narrow_screen_shows_all_of_a_flight(page: Any) -> None:
    page.set_viewport_size({"width": 380, "height": 800})
    page.wait_for_selector("#plots canvas")
    assert page.evaluate("document.documentElement.scrollWidth") <= 380


@pytest.mark.browser
def test_the_end_of_the_search_is_shown(browser: Any, tmp_path: Path) -> None:
    viewer = browser.new_page()
    with serve_search_page(make_flights(TEST, tmp_path)) as address:
        viewer.goto(address)
        viewer.wait_for_selector("#next:not([disabled])")
    viewer.wait_for_selector("#flying:has-text('the search has ended')")
    assert viewer.is_disabled("#next")
    viewer.close()
