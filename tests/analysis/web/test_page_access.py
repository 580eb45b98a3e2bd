"""Who may look at the page, and who may change something by it."""

import os
import socket
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

import pytest
from websockets import Origin
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from analysis.web import access_control
from analysis.web.page_server import open_socket
from analysis.web.peer_user import HAS_TABLES, peer_user


@pytest.mark.browser
def test_a_second_viewer_without_the_token_sees_the_same_and_can_change_nothing(
    browser: Any, page: Any, address: str
) -> None:
    page.select_option("#kind", "preset:gyro-bias")
    page.click("#arm")
    second = browser.new_page()
    second.goto(address.partition("#")[0])
    second.wait_for_selector("#faults li.active")
    assert second.is_visible("#viewing")
    assert all(
        one.is_disabled() for one in second.query_selector_all("section:first-of-type button")
    )
    second.close()


@pytest.mark.browser
def test_a_wrong_token_is_explained_where_it_was_used(
    address: str, loop: Any, open_page: Callable[[str], Any]
) -> None:
    page = open_page(address.replace("token=", "token=not-"))
    page.select_option("#kind", "preset:gyro-bias")
    page.click("#arm")
    page.wait_for_selector("#form-message:has-text('the token is wrong')")
    assert loop.engine.ids() == []


def status_of(address: str, headers: dict[str, str], what: str = "ctl/schedule/stop") -> int:
    origin = address.partition("/#")[0]
    url = f"{origin}/api/{what}"
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
def test_requests_without_the_token_or_from_elsewhere_are_refused(
    address: str, headers: dict[str, str]
) -> None:
    token = address.partition("token=")[2]
    given = {key: value.replace("TOKEN", token) for key, value in headers.items()}
    assert status_of(address, given) == 403


def test_another_site_can_neither_read_nor_listen(address: str) -> None:
    origin = address.partition("/#")[0]
    elsewhere = {"Origin": "http://elsewhere.example"}
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(urllib.request.Request(origin, headers=elsewhere), timeout=10)
    with (
        pytest.raises(InvalidStatus),
        connect(
            f"{origin.replace('http', 'ws')}/api/live", origin=Origin("http://elsewhere.example")
        ),
    ):
        pass


def test_the_page_is_reached_on_loopback_only() -> None:
    bound = open_socket(0)
    assert bound.getsockname()[0] == "127.0.0.1"
    bound.close()


def test_another_run_is_chosen_with_the_token_only(address: str) -> None:
    assert status_of(address, {}, "run") == 403


ROUTES = ["", "assets/page.js", "api/catalogue", "api/live", "api/preview", "api/run",
          "api/allowed", "api/sequence/check", "api/sequence/read/a", "api/sequence/write/a",
          "api/ctl/schedule/stop"]  # fmt: skip


@pytest.mark.skipif(not HAS_TABLES, reason="the system does not report the user of a connection")
def test_another_user_without_the_token_is_refused_on_every_route(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    origin, token = address.split("/#token=")
    posts = [route for route in ROUTES if route.startswith("api/") and "catalogue" not in route]
    # To the server every caller is now another user.
    monkeypatch.setattr(access_control, "peer_user", lambda *_: 12345)
    for route in ROUTES:
        if route == "api/live":
            with (
                pytest.raises(InvalidStatus, match="403"),
                connect(f"{origin.replace('http', 'ws')}/api/live"),
            ):
                pass
            continue
        data = b"" if route in posts else None
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(f"{origin}/{route}", data), timeout=10)
    with connect(f"{origin.replace('http', 'ws')}/api/live?token={token}") as live:
        assert live.recv(timeout=10)


@pytest.mark.skipif(not HAS_TABLES, reason="the system does not report the user of a connection")
@pytest.mark.parametrize("host", ["127.0.0.1", "::ffff:127.0.0.1"])
def test_the_user_of_a_connection_is_told_until_it_is_closed(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(family) as client:
        client.connect((host, server.getsockname()[1]))
        connection, caller = server.accept()
        with connection:
            assert peer_user(caller, server.getsockname()) == os.getuid()
            client.close()  # a closed socket looks like root's
            assert peer_user(caller, server.getsockname()) is None
