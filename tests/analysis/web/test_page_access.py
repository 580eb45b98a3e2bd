"""Who may look at the page, and who may change something by it."""

import asyncio
import os
import re
import socket
import urllib.error
import urllib.request
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import pytest
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from websockets import Origin
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from analysis.search_page.flight_routes import FlightPage
from analysis.web import access_control
from analysis.web.access_control import AccessControl
from analysis.web.feed import Feed
from analysis.web.page_server import open_socket
from analysis.web.peer_user import HAS_TABLES, peer_user
from analysis.web.routes import LivePage
from analysis.web.run_source import RunSource
from analysis.web.sequence_folder import SequenceFolder


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


HOST = "127.0.0.1:8350"
METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS")


def pages(access: AccessControl) -> list[Starlette]:
    """Every page that this program serves."""
    feed = Feed()
    live = LivePage(feed, RunSource(feed, None, ""), access, SequenceFolder(None), True)
    return [live.app, FlightPage(cast(Any, None), access).app]


def status_without_server(app: Starlette, kind: str, path: str, method: str, token: str) -> int:
    """The status of one call from an unknown user, as the server passes it to the page."""
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect" if kind == "websocket" else "http.disconnect"}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": kind, "method": method, "path": path, "root_path": "", "scheme": "http",
        "query_string": f"token={token}".encode(), "headers": [(b"host", HOST.encode())],
        "client": ("127.0.0.1", 50_000), "server": ("127.0.0.1", 8350),
        "extensions": {"websocket.http.response": {}},
    }  # fmt: skip
    with ThreadPoolExecutor(1) as thread:  # another test's browser has a loop in this one
        thread.submit(asyncio.run, app(scope, receive, send)).result()
    # The server answers a close with 403; another answer to a WebSocket it would log as an error.
    refused = sent[0]["type"] == "websocket.close"
    return 403 if refused else int(sent[0].get("status", 101))


def test_a_stranger_is_refused_on_every_route_of_every_page() -> None:
    tried = 0
    for app in pages(AccessControl("secret", frozenset({HOST}), frozenset())):
        for route in app.routes:
            path = re.sub(r"{\w+(:\w+)?}", "x", cast(Any, route).path)
            kind = "websocket" if isinstance(route, WebSocketRoute) else "http"
            for token in ("", "guessed"):
                for method in METHODS:
                    assert status_without_server(app, kind, path, method, token) == 403, path
                    tried += 1
            if path == "/":
                assert status_without_server(app, kind, path, "GET", "secret") == 200
        assert status_without_server(app, "http", "/no/such/route", "GET", "") == 403
    assert tried > 200


def test_where_users_are_unknown_only_the_page_s_own_files_need_no_token(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(access_control, "HAS_TABLES", False)
    monkeypatch.setattr(access_control, "peer_user", lambda *_: None)
    for app in pages(AccessControl("secret", frozenset({HOST}), frozenset())):
        assert status_without_server(app, "http", "/", "GET", "") == 200
        assert status_without_server(app, "http", "/assets/uPlot.min.css", "GET", "") == 200
        for path in ("/api/report", "/api/catalogue", "/api/state", "/api/live", "/assets/../api"):
            assert status_without_server(app, "http", path, "GET", "") == 403


@pytest.mark.skipif(not HAS_TABLES, reason="the system does not identify the user of a connection")
def test_another_user_hears_nothing_without_the_token(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    live = f"{address.partition('/#')[0].replace('http', 'ws')}/api/live"
    # To the server every caller is now another user.
    monkeypatch.setattr(access_control, "peer_user", lambda *_: 12345)
    with pytest.raises(InvalidStatus, match="403"), connect(live):
        pass
    with connect(f"{live}?token={address.partition('token=')[2]}") as heard:
        assert heard.recv(timeout=10)


@pytest.mark.skipif(not HAS_TABLES, reason="the system does not identify the user of a connection")
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
