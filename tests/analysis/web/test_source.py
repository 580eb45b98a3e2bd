import queue
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from analysis.web.feed import STATUS_KEY, Feed
from analysis.web.run_source import RunSource
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.links.bus_users import CONFIG


class Statuses(Feed):
    """A feed that hands what the source says about the run to the test."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: queue.Queue[tuple[str, object]] = queue.Queue()

    def add_sample(self, key: str, payload: bytes) -> None:
        super().push(key, payload)
        self.heard.put((key, msgspec.json.decode(payload)))

    def next_run(self) -> object:
        """The run of the next status."""
        while True:
            key, value = self.heard.get(timeout=20)
            if key == STATUS_KEY:
                assert isinstance(value, dict)
                return value["run"]


@pytest.fixture
def feed() -> Statuses:
    return Statuses()


@pytest.fixture
def source(feed: Statuses) -> Iterator[RunSource]:
    with open_bus("tcp/127.0.0.1:0", router=True) as found:
        url = found.url
    running = RunSource(feed, url)
    running.start()
    yield running
    running.close()


def test_a_request_without_a_proxy_says_that_there_is_none(
    feed: Statuses, source: RunSource
) -> None:
    assert feed.next_run() is None
    with pytest.raises(ConfigError, match="no proxy and no run is there"):
        source.query("schedule/stop", b"")


def test_the_source_follows_a_proxy_that_goes_and_comes_back(
    feed: Statuses, source: RunSource
) -> None:
    assert feed.next_run() is None
    for run in ("first", "second"):
        with open_bus(source.url, run=run, router=True) as proxy:
            proxy.serve_queries("@ctl/**", lambda key, payload, run=run: {"run": run})
            proxy.declare_alive("proxy")
            assert feed.next_run() == run
            assert msgspec.json.decode(source.query("schedule/save", b"")) == {"run": run}
        assert feed.next_run() is None


def test_a_source_of_another_user_joins_with_the_configuration_it_is_given(
    feed: Statuses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "theirs"))
    with open_bus("tcp/127.0.0.1:0", run="first", router=True) as proxy:
        proxy.declare_alive("proxy")
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "ours"))
        with pytest.raises(ConfigError, match="refused the connection"):
            open_bus(proxy.url)
        source = RunSource(feed, proxy.url, str(*tmp_path.glob(f"theirs/*/*/{CONFIG}")))
        source.start()
        try:
            assert feed.next_run() is None
            assert feed.next_run() == "first"
        finally:
            source.close()


def test_a_run_that_is_not_there_cannot_be_chosen(source: RunSource) -> None:
    with pytest.raises(ConfigError, match="'nobody' is not there; there are: none"):
        source.choose("nobody")
