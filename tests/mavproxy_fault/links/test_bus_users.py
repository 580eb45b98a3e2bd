"""By default the bus admits only programs of its own user."""

import json
import threading
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.links.bus_users import CONFIG, USERS, credentials_folder

ANY_PORT = "tcp/127.0.0.1:0"


@pytest.fixture
def other_user(tmp_path: Path) -> str:
    """A configuration without a password or user."""
    path = tmp_path / "open.json5"
    path.write_text("{}")
    return str(path)


def test_programs_of_the_user_are_admitted_and_others_are_refused_with_a_reason(
    other_user: str,
) -> None:
    with open_bus(ANY_PORT, run="test", router=True) as hub:
        hub.serve_queries("@ctl/x", lambda key, payload: "in")
        with open_bus(hub.url, run="test") as own:
            assert own.query("@ctl/x") == [b'"in"']
        with pytest.raises(ConfigError, match="refused the connection"):
            open_bus(hub.url, run="test", config_file=other_user)


def test_a_plain_zenoh_program_joins_with_the_file_of_the_user() -> None:
    import zenoh

    with open_bus(ANY_PORT, run="test", router=True) as hub:
        hub.serve_queries("@ctl/x", lambda key, payload: "in")
        config = zenoh.Config.from_file(str(credentials_folder() / CONFIG))
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([hub.url]))
        with zenoh.open(config) as session:
            replies = session.get(hub.key("@ctl/x"), timeout=3.0)
            assert [reply.ok.payload.to_string() for reply in replies] == ['"in"']


@pytest.mark.parametrize("by_variable", [False, True])
def test_a_router_without_a_password_is_joined(
    other_user: str, by_variable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if by_variable:
        monkeypatch.setenv("ZENOH_CONFIG", other_user)
    given = "" if by_variable else other_user
    with open_bus(ANY_PORT, run="test", router=True, config_file=given) as hub:
        hub.serve_queries("@ctl/x", lambda key, payload: "in")
        monkeypatch.delenv("ZENOH_CONFIG", raising=False)
        with open_bus(hub.url, run="test") as client:
            assert client.query("@ctl/x") == [b'"in"']


def test_only_the_user_can_read_the_password_and_it_is_made_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    found: list[bytes] = []

    def read() -> None:
        found.append((credentials_folder() / CONFIG).read_bytes())

    threads = [threading.Thread(target=read) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert len(set(found)) == 1
    folder = credentials_folder()
    assert sorted(path.name for path in folder.parent.iterdir()) == [folder.name]
    assert [(folder / name).stat().st_mode & 0o777 for name in (CONFIG, USERS)] == [0o600] * 2
    assert folder.stat().st_mode & 0o777 == 0o700


def test_without_a_home_the_password_is_stored_in_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/no-such-home")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert credentials_folder().is_relative_to(tmp_path)
    monkeypatch.setenv("TMPDIR", "/proc/neither")
    with pytest.raises(ConfigError, match="XDG_STATE_HOME"):
        credentials_folder()
