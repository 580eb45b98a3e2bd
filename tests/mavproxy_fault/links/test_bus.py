"""The Zenoh session on loopback."""

import queue

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import Bus, open_bus


def router() -> Bus:
    return open_bus("tcp/127.0.0.1:0", run="test", router=True)


def test_a_client_receives_what_the_router_publishes() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        got: queue.Queue[tuple[str, bytes]] = queue.Queue(10)
        client.subscribe("fdi/**", lambda key, payload: got.put((key, payload)))
        hub.put("fdi/main/stat", b'{"t_s": 1}', history=1)
        assert got.get(timeout=5) == ("mavfault/v1/test/fdi/main/stat", b'{"t_s": 1}')


def test_a_late_subscriber_gets_the_history_that_was_kept() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        for number in range(5):
            hub.put("fdi/events", b"%d" % number, history=3)
        got: queue.Queue[bytes] = queue.Queue(10)
        client.subscribe("fdi/events", lambda _, payload: got.put(payload))
        assert [got.get(timeout=5) for _ in range(3)] == [b"2", b"3", b"4"]


def test_a_query_is_answered_with_json() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.answer("@ctl/fault/*/arm", lambda key, payload: {"key": key, "size": len(payload)})
        assert client.ask("@ctl/fault/gyro/arm", b"{}") == [
            b'{"key": "mavfault/v1/test/@ctl/fault/gyro/arm", "size": 2}'
        ]


def test_a_refused_query_raises_with_the_reason() -> None:
    def refuse(key: str, payload: bytes) -> object:
        raise ConfigError("fault 'x' is unknown; known: gyro")

    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.answer("@ctl/fault/*/arm", refuse)
        with pytest.raises(ConfigError, match="known: gyro"):
            client.ask("@ctl/fault/x/arm")


def test_a_wildcard_query_does_not_reach_live_control() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.answer("@ctl/fault/gyro/arm", lambda key, payload: "armed")
        with pytest.raises(ConfigError, match="nobody answers"):
            client.ask("**", timeout_s=0.3)


def test_components_are_seen_while_they_live() -> None:
    with router() as hub, open_bus(hub.url, run="test") as client:
        hub.alive("proxy")
        assert client.who() == ["mavfault/v1/test/alive/proxy"]


def test_without_a_router_the_error_names_the_address() -> None:
    with pytest.raises(ConfigError, match=r"tcp/127\.0\.0\.1:1 has no router listening"):
        open_bus("tcp/127.0.0.1:1")


def test_a_taken_address_is_said_so() -> None:
    with router() as hub, pytest.raises(ConfigError, match="cannot be opened as the router"):
        open_bus(hub.url, router=True)
