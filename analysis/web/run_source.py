"""Where the page's data comes from: a run that is alive on the bus, followed over restarts."""

import contextlib
import threading
from typing import Any

import msgspec

from analysis.web.feed import Feed
from analysis.web.run_summaries import SUBSCRIBED, RunSummaries
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import DEFAULT_URL, ROOT, Bus, open_bus

POLL_S = 0.5  # between two looks at who is there
STREAMS = ("fdi/**", "att/**", "fusion/**", "schedule/**", "proxy/**")
PROXY, RUN = "/alive/proxy", "/alive/run"


class RunSource:
    """Feeds what the live run publishes, and carries requests to it."""

    def __init__(self, feed: Feed, url: str | None, config_file: str = "") -> None:
        self._feed = feed
        self.url = url or DEFAULT_URL
        self._config_file = config_file
        self._stopping = threading.Event()
        self._bus: Bus | None = None
        self._listener: Bus | None = None
        self._runs: list[str] = []
        self._starting: list[str] = []  # runs, of which some are still getting ready
        self._rows = RunSummaries()
        self._shown: dict[str, Any] = {}  # the rows that the viewers have
        self._chosen: str | None = None
        # No daemon: one that is inside Zenoh when the interpreter ends aborts the process.
        self._thread = threading.Thread(target=self._follow, name="bus of the page")

    def start(self) -> None:
        """Begin to look for a proxy or run."""
        self._publish_status()
        self._thread.start()

    def close(self) -> None:
        """Leave the bus, if it was joined; closing twice does nothing more."""
        self._stopping.set()
        if self._thread.ident is not None:  # it was started
            self._thread.join()

    def choose(self, run: str) -> None:
        """Follow another of the runs that are there.

        Raises
        ------
        ConfigError
            If there is none of that name.
        """
        if run not in self._runs:
            there = ", ".join(self._runs) or "none"
            raise ConfigError(f"run {run!r} is not there; there are: {there}")
        self._chosen = run

    def query(self, what: str, payload: bytes) -> bytes:
        """The answer of the proxy to a query below `@ctl/`.

        Raises
        ------
        ConfigError
            If it refuses, or there is none.
        """
        bus = self._bus
        if bus is None:
            raise ConfigError(f"{self.url}: no proxy and no run is there; start one first")
        return bus.query(f"@ctl/{what}", payload)[0]

    def _follow(self) -> None:
        with contextlib.ExitStack() as stack:
            stack.callback(self._leave)
            while not self._stopping.is_set():
                self._find_runs(stack)
                self._request_messages()
                self._stopping.wait(POLL_S)

    def _request_messages(self) -> None:
        """Have the proxy show what the viewers want to see; it forgets in some seconds."""
        wishes = self._feed.requested_messages()
        if wishes and self._bus is not None:
            with contextlib.suppress(ConfigError):  # a proxy that is just going
                self._bus.query("@ctl/watch", msgspec.json.encode(wishes))

    def _find_runs(self, stack: contextlib.ExitStack) -> None:
        """Join the run that is alive, leave the one that is not."""
        try:
            if self._listener is None:
                self._listener = stack.enter_context(self._open("*"))
                for suffix in SUBSCRIBED:
                    self._listener.subscribe(suffix, self._rows.add_sample)
            there = self._listener.list_components()
            runs = [run_of(key) for key in there if key.endswith(PROXY)]
            coming = [run_of(key) for key in there if key.endswith(RUN)]
            joined = self._bus.run if self._bus is not None else None
            # The one chosen, else the one followed so far, else the newest.
            wanted = next((run for run in (self._chosen, joined, *runs[-1:]) if run in runs), None)
            # Of one run all is on the page anyway.
            rows = self._rows.summaries_of(runs) if len(runs) > 1 else {}
            changed = (runs, coming, rows) != (self._runs, self._starting, self._shown)
            self._runs, self._starting, self._shown = runs, coming, rows
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
        # Keys are shown without the run's prefix.
        prefix = len(bus.key(""))
        self._bus = bus
        self._publish_status()  # before its first sample: the page clears its plots
        for stream in STREAMS:
            bus.subscribe(stream, lambda key, payload: self._feed.add_sample(key[prefix:], payload))

    def _leave(self) -> None:
        if self._bus is None:
            return
        # Cleared first: threads that ask now find none rather than a closed one.
        bus, self._bus = self._bus, None
        bus.close()
        self._publish_status()

    def _publish_status(self) -> None:
        run = None if self._bus is None else self._bus.run
        coming = [name for name in self._starting if name not in self._runs]
        news = {"run": run, "runs": self._runs, "coming": coming, "url": self.url}
        self._feed.set_status({**news, "rows": self._shown})


def run_of(key: str) -> str:
    """The run in the key of a component that is alive."""
    return key.removeprefix(f"{ROOT}/").partition("/")[0]
