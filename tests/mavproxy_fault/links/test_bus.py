"""The Zenoh session on loopback."""

import json
import os
import queue
import socket
import time
from concurrent.futures import Future
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import bus
from mavproxy_fault.links.bus import Bus, check_run_name, open_bus, open_run_bus


def router() -> Bus:
    return open_bus("tcp/127.0.0.1:0", run="test", router=True)


def test_a_client_receives_what_the_router_publishes() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        got: queue.Queue[tuple[str, bytes]] = queue.Queue(10)
        client.subscribe("fdi/**", lambda key, payload: got.put((key, payload)))
        hub.put("fdi/main/stat", b'{"t_s": 1}', history=1)
        assert got.get(timeout=5) == ("mavfault/v1/test/fdi/main/stat", b'{"t_s": 1}')


def test_a_late_subscriber_gets_the_stored_history() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        for number in range(5):
            hub.put("fdi/events", b"%d" % number, history=3)
        got: queue.Queue[bytes] = queue.Queue(10)
        client.subscribe("fdi/events", lambda _, payload: got.put(payload))
        assert [got.get(timeout=5) for _ in range(3)] == [b"2", b"3", b"4"]


def test_a_query_is_answered_with_json() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.serve_queries(
            "@ctl/fault/*/arm", lambda key, payload: {"key": key, "size": len(payload)}
        )
        assert client.query("@ctl/fault/gyro/arm", b"{}") == [
            b'{"key": "mavfault/v1/test/@ctl/fault/gyro/arm", "size": 2}'
        ]


def test_a_refused_query_raises_with_the_reason() -> None:
    def refuse(key: str, payload: bytes) -> object:
        raise ConfigError("fault 'x' is unknown; known: gyro")

    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.serve_queries("@ctl/fault/*/arm", refuse)
        with pytest.raises(ConfigError, match="known: gyro"):
            client.query("@ctl/fault/x/arm")


def test_a_wildcard_query_does_not_reach_live_control() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.serve_queries("@ctl/fault/gyro/arm", lambda key, payload: "armed")
        with pytest.raises(ConfigError, match="no reply for"):
            client.query("**", timeout_s=0.3)


def test_components_are_listed_while_they_live() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.declare_alive("proxy")
        assert client.list_components() == ["mavfault/v1/test/alive/proxy"]


def test_without_a_router_the_error_names_the_address() -> None:
    with pytest.raises(ConfigError, match=r"no proxy or run is at zenoh tcp/127\.0\.0\.1:1; start"):
        open_bus("tcp/127.0.0.1:1")


def test_an_address_in_use_is_reported() -> None:
    with router() as hub, pytest.raises(ConfigError, match="cannot be opened as the router"):
        open_bus(hub.url, router=True)


def test_a_refusal_is_returned_at_once_even_from_another_thread() -> None:
    def refuse(key: str, payload: bytes) -> object:
        outcome: Future[object] = Future()
        outcome.set_exception(ConfigError("no"))
        return outcome.result()  # the traceback refers to this frame, which refers to the future

    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.serve_queries("@ctl/x", refuse)
        begun_s = time.monotonic()
        with pytest.raises(ConfigError, match="no"):
            client.query("@ctl/x", timeout_s=60)
        assert time.monotonic() - begun_s < 30.0


def test_a_bug_is_reported_without_its_text() -> None:
    def fail(key: str, payload: bytes) -> object:
        raise RuntimeError("a secret")

    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.serve_queries("@ctl/x", fail)
        with pytest.raises(ConfigError, match="because of a bug") as caught:
            client.query("@ctl/x")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("name", ["a/b", "@ctl", "", "a b", "$*", "*"])
def test_a_name_that_is_invalid_in_a_key_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="--run"):
        check_run_name(name)


def test_an_empty_address_is_not_the_default_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "DEFAULT_URL", "tcp/127.0.0.1:0")
    with pytest.raises(ConfigError, match="'' is not an address"):
        open_bus("", run="test", router=True)


def test_users_of_a_zenoh_configuration_are_admitted_and_others_are_not(tmp_path: Path) -> None:
    users = tmp_path / "users.txt"
    users.write_text("alice:wonder\n")
    files = {}
    for name, user, password in (("hub", "alice", "wonder"), ("eve", "alice", "guess")):
        auth = {"user": user, "password": password}
        if name == "hub":
            auth["dictionary_file"] = str(users)
        files[name] = tmp_path / f"{name}.json5"
        files[name].write_text(json.dumps({"transport": {"auth": {"usrpwd": auth}}}))
    hub = open_bus(
        "tcp/127.0.0.1:0", run="test", router=True, config_file=str(files["hub"])
    )  # fmt: skip
    with hub:
        hub.serve_queries("@ctl/x", lambda key, payload: "in")
        alice = open_bus(hub.url, run="test", config_file=str(files["hub"]))
        with alice:
            assert alice.query("@ctl/x") == [b'"in"']
        for config in ("", str(files["eve"])):
            with pytest.raises(ConfigError):
                open_bus(hub.url, run="test", config_file=config).query("@ctl/x", timeout_s=1)


def test_an_unreadable_configuration_is_a_user_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--zenoh-config"):
        open_bus(config_file=str(tmp_path / "none.json5"))


def test_a_default_address_that_is_another_programs_costs_the_bus_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.socket() as foreign:
        foreign.bind(("127.0.0.1", 0))
        foreign.listen()
        url = f"tcp/127.0.0.1:{foreign.getsockname()[1]}"
        monkeypatch.setattr(bus, "DEFAULT_URL", url)
        monkeypatch.setattr(bus, "OPEN_MS", 300)
        with open_run_bus("auto", "test") as found:
            assert found is None
        assert "nothing is published" in caplog.text
        held = (
            rf"cannot be opened as the router: port \d+ is in use by .* \(process {os.getpid()}\)"
        )
        begun_s = time.monotonic()
        with pytest.raises(ConfigError, match=held), open_run_bus(url, "test"):
            pass
        assert time.monotonic() - begun_s < 10.0  # Zenoh's own timeout would be 20 s or more
