"""Bus samples for the viewers: one batch per tick, encoded once for all of them.

Streams are thinned to the newest few samples of each key and tick; events and labels are complete
up to a bound. A viewer that does not keep up loses batches and gets a new snapshot; it never slows
the bus or another viewer. Viewers request the messages whose values they show.
"""

import asyncio
import shlex
import sys
import threading
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.subscriptions import MOST_MESSAGES, RANGES
from mavproxy_fault.wire.dialect import find_layout

MAX_EVENTS = 200  # events and labels in the snapshot of a late joiner
MAX_QUEUED_BATCHES = 25  # batches a viewer may lag: one second of ticks
EVENT_KEYS = ("fdi/events", "proxy/labels")  # no sample is dropped
SAMPLES_PER_TICK = 25  # samples of one key per tick: a monitor publishes its results once a second
CURVE_SAMPLES = 300  # samples of a curve in the snapshot: a minute at 5 Hz
CURVE_KEYS = ("fdi/", "att/")
# Keys of which only the newest sample is kept.
STATE_KEYS = ("schedule/state", "proxy/stats", "proxy/recording", "page/status")
MAX_KEYS = 500  # bounds the memory of a run
MAX_VIEWERS = 100  # measured in benchmarks/page.md
STATUS_KEY = "page/status"
END_KEY = "page/end"  # of the flight, with its verdict
OWN_KEYS = "page/"  # of the page itself, not of the run


class Viewer:
    """One open page, with its queue of batches."""

    def __init__(self, first: str) -> None:
        self.queue: asyncio.Queue[str] = asyncio.Queue(MAX_QUEUED_BATCHES)
        self.queue.put_nowait(first)
        self.messages: frozenset[str] = frozenset()

    def request_messages(self, text: str) -> None:
        """Set the messages whose values it shows, a JSON list; unknown ones are ignored."""
        try:
            names = msgspec.json.decode(text, type=list[str])
        except msgspec.MsgspecError:
            # Malformed requests are ignored.
            return
        self.messages = frozenset(
            name for name in names[:MOST_MESSAGES] if name == RANGES or find_layout(name)
        )


class Feed:
    """Takes samples from any thread, sends batches on the event loop's."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._past: dict[str, deque[bytes]] = {}
        self._fresh: dict[str, deque[bytes]] = {}
        self._events: deque[tuple[str, bytes]] = deque(maxlen=MAX_EVENTS)
        self._unsent: deque[tuple[str, bytes]] = deque(maxlen=MAX_EVENTS)
        self._viewers: set[Viewer] = set()
        self.report: Path | None = None
        self.fetched = threading.Semaphore(0)  # released for each request for the report

    def add_sample(self, key: str, payload: bytes) -> None:
        """Add one sample; `key` is relative to the run's prefix."""
        try:
            msgspec.json.decode(payload)
        except msgspec.DecodeError:
            return  # it would make the entire batch invalid
        with self._lock:
            if key in EVENT_KEYS:
                self._events.append((key, payload))
                self._unsent.append((key, payload))
            # A run with many keys must not fill the memory.
            elif key in self._past or len(self._past) < MAX_KEYS:
                past = CURVE_SAMPLES if key.startswith(CURVE_KEYS) else 1
                burst = 1 if key in STATE_KEYS else SAMPLES_PER_TICK
                self._past.setdefault(key, deque(maxlen=past)).append(payload)
                self._fresh.setdefault(key, deque(maxlen=burst)).append(payload)

    def set_status(self, state: object) -> None:
        """Publish the status of the page itself."""
        self.add_sample(STATUS_KEY, msgspec.json.encode(state))

    def announce_end(self, result: dict[str, Any], report: Path | None) -> None:
        """Announce the end of the flight to the viewers: result, report, and its command."""
        self.report = report
        path = None if report is None else str(report)
        again = shlex.join(["mavproxy-fault", *sys.argv[1:]])
        end = {**result, "report": path, "again": again}
        self.add_sample(END_KEY, msgspec.json.encode(end))

    def clear_run(self) -> None:
        """Drop the samples of a run that has ended; the status is kept."""
        with self._lock:
            self._past, self._fresh = (
                {key: data for key, data in samples.items() if key.startswith(OWN_KEYS)}
                for samples in (self._past, self._fresh)
            )
            self._events.clear()
            self._unsent.clear()

    def add_viewer(self) -> Viewer:
        """Add a viewer; its first batch is a snapshot.

        Raises
        ------
        ConfigError
            If there are too many viewers.
        """
        if len(self._viewers) >= MAX_VIEWERS:
            raise ConfigError(f"the page already has {MAX_VIEWERS} viewers; close one")
        # The snapshot first: batches alone have no history.
        viewer = Viewer(self._snapshot())
        self._viewers.add(viewer)
        return viewer

    def remove_viewer(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        self._viewers.discard(viewer)

    @property
    def viewers(self) -> int:
        """Number of open pages."""
        return len(self._viewers)

    def requested_messages(self) -> list[str]:
        """The messages requested by viewers, up to the proxy's limit."""
        requested: set[str] = set()
        # A copy: the loop's thread adds and removes viewers.
        for viewer in tuple(self._viewers):
            requested |= viewer.messages
        return sorted(requested)[:MOST_MESSAGES]

    def tick(self) -> None:
        """Queue the samples since the last tick for every viewer."""
        # Hold the lock only for the exchange: the bus adds samples from other threads.
        with self._lock:
            samples = order_samples(self._unsent, self._fresh)
            self._unsent.clear()
            self._fresh.clear()
        if not samples:
            return
        batch = encode_batch(samples)
        for viewer in self._viewers:
            # It has lost batches: a snapshot restores its state.
            if viewer.queue.full():
                while not viewer.queue.empty():
                    viewer.queue.get_nowait()
                batch_for = self._snapshot()
            else:
                batch_for = batch
            viewer.queue.put_nowait(batch_for)

    def _snapshot(self) -> str:
        with self._lock:
            return encode_batch(
                [("page/picture", b"null"), *order_samples(self._events, self._past)]
            )


def order_samples(
    events: Iterable[tuple[str, bytes]], samples: dict[str, deque[bytes]]
) -> list[tuple[str, bytes]]:
    """States first, since they give the run and time origin of the rest."""
    flat = [(key, payload) for key, payloads in samples.items() for payload in payloads]
    states = [sample for sample in flat if sample[0] in STATE_KEYS]
    return [*states, *events, *(sample for sample in flat if sample[0] not in STATE_KEYS)]


def encode_batch(samples: list[tuple[str, bytes]]) -> str:
    """Encode samples as a JSON list of [key, value]."""
    # The values are JSON already.
    parts = [f"[{msgspec.json.encode(key).decode()},{data.decode()}]" for key, data in samples]
    return f"[{','.join(parts)}]"
