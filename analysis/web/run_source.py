"""The page's data source: a live run on the bus, also after restarts."""

import contextlib
import threading
import time
from typing import Any

import msgspec

from analysis.web.feed import Feed
from analysis.web.run_summaries import SUBSCRIBED, RunSummaries
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import DEFAULT_URL, ROOT, Bus, open_bus
from mavproxy_fault.live.subscriptions import LEASE_S

POLL_S = 0.5  # between two searches for runs
RENEW_S = LEASE_S / 3  # between two requests of the same messages
STREAMS = ("fdi/**", "att/**", "fusion/**", "schedule/**", "proxy/**")
PROXY, RUN = "/alive/proxy", "/alive/run"


class RunSource:
    """Forwards the samples of the live run to the feed, and requests to the run."""

    def __init__(self, feed: Feed, url: str | None, config_file: str = "") -> None:
        self._feed = feed
        self.url = url or DEFAULT_URL
        self._config_file = config_file
        self._stopping = threading.Event()
        self._bus: Bus | None = None
        self._listener: Bus | None = None
        self._runs: list[str] = []
        self._starting: list[str] = []  # runs, including those that are starting
        self._rows = RunSummaries()
        self._shown: dict[str, Any] = {}  # the summaries that the viewers have
        self._chosen: str | None = None
        self._asked: tuple[Bus | None, list[str]] = (None, [])  # for which messages
        self._renew_s = 0.0
        # Not a daemon: inside Zenoh at interpreter exit it would abort the process.
        self._thread = threading.Thread(target=self._follow, name="bus of the page")

    def start(self) -> None:
        """Start to search for a proxy or run."""
        self._publish_status()
        self._thread.start()

    def close(self) -> None:
        """Leave the bus; may be called twice."""
        self._stopping.set()
        if self._thread.ident is not None:  # it was started
            self._thread.join()

    def choose(self, run: str) -> None:
        """Switch to another of the available runs.

        Raises
        ------
        ConfigError
            If there is no run of that name.
        """
        if run not in self._runs:
            available = ", ".join(self._runs) or "none"
            raise ConfigError(f"run {run!r} is not available; available: {available}")
        self._chosen = run

    def query(self, what: str, payload: bytes) -> bytes:
        """The proxy's reply to a query below `@ctl/`.

        Raises
        ------
        ConfigError
            If it refuses, or there is no proxy.
        """
        bus = self._bus
        if bus is None:
            raise ConfigError(f"{self.url}: no proxy or run is available; start one first")
        return bus.query(f"@ctl/{what}", payload)[0]

    def _follow(self) -> None:
        with contextlib.ExitStack() as stack:
            stack.callback(self._leave)
            while not self._stopping.is_set():
                self._find_runs(stack)
                self._request_messages()
                self._stopping.wait(POLL_S)

    def _request_messages(self) -> None:
        """Request the viewers' messages from the proxy; a request expires after some seconds."""
        now_s, asked = time.monotonic(), (self._bus, self._feed.requested_messages())
        bus, requested = asked
        if bus is not None and requested and (asked != self._asked or now_s >= self._renew_s):
            with contextlib.suppress(ConfigError):  # the proxy may be shutting down
                bus.query("@ctl/watch", msgspec.json.encode(requested))
                self._asked, self._renew_s = asked, now_s + RENEW_S

    def _find_runs(self, stack: contextlib.ExitStack) -> None:
        """Join a live run, leave one that has ended."""
        try:
            if self._listener is None:
                self._listener = stack.enter_context(self._open("*"))
                for suffix in SUBSCRIBED:
                    self._listener.subscribe(suffix, self._rows.add_sample)
            available = self._listener.list_components()
            runs = [run_of(key) for key in available if key.endswith(PROXY)]
            starting = [run_of(key) for key in available if key.endswith(RUN)]
            joined = self._bus.run if self._bus is not None else None
            # The chosen run, else the current one, else the newest.
            wanted = next((run for run in (self._chosen, joined, *runs[-1:]) if run in runs), None)
            # A single run needs no summary.
            rows = self._rows.summaries_of(runs) if len(runs) > 1 else {}
            changed = (runs, starting, rows) != (self._runs, self._starting, self._shown)
            self._runs, self._starting, self._shown = runs, starting, rows
            if wanted != joined:
                self._leave()
                if wanted is not None:
                    self._join(wanted)
            elif changed:
                self._publish_status()
        except ConfigError:
            self._leave()

    def _open(self, run: str) -> Bus:
        return open_bus(self.url, run=run, config_file=self._config_file)

    def _join(self, run: str) -> None:
        self._feed.clear_run()
        bus = self._open(run)
        # The feed uses keys without the run's prefix.
        prefix = len(bus.key(""))
        self._bus = bus
        self._publish_status()  # before its first sample: the page clears its plots
        for stream in STREAMS:
            bus.subscribe(stream, lambda key, payload: self._feed.add_sample(key[prefix:], payload))

    def _leave(self) -> None:
        if self._bus is None:
            return
        # Cleared first: other threads must find none rather than a closed one.
        bus, self._bus = self._bus, None
        bus.close()
        self._publish_status()

    def _publish_status(self) -> None:
        run = None if self._bus is None else self._bus.run
        starting = [name for name in self._starting if name not in self._runs]
        news = {"run": run, "runs": self._runs, "coming": starting, "url": self.url}
        self._feed.set_status({**news, "rows": self._shown})


def run_of(key: str) -> str:
    """The run in the liveliness key of a component."""
    return key.removeprefix(f"{ROOT}/").partition("/")[0]
