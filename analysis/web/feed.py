"""What the bus says, gathered for the viewers: one batch each tick, encoded once for all of them.

Streams are thinned to the newest few samples of each key and tick; what must not be lost (events,
labels) is kept whole up to a bound. A viewer that does not keep up loses batches and is given
the whole picture again; it never slows the bus or another viewer. Viewers say which messages they
want to see the values of.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Iterable

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.subscriptions import MOST_MESSAGES, RANGES
from mavproxy_fault.wire.dialect import find_layout

MAX_EVENTS = 200  # events and labels remembered for late joiners
MAX_QUEUED_BATCHES = 25  # batches a viewer may be behind: one second
EVENT_KEYS = ("fdi/events", "proxy/labels")  # every sample counts
SAMPLES_PER_TICK = 25  # samples of one key sent in one tick: a monitor's results come by the second
CURVE_SAMPLES = 300  # samples of a curve that a late joiner is shown
CURVE_KEYS = ("fdi/main/", "att/")
# Only the newest counts.
STATE_KEYS = ("schedule/state", "proxy/stats", "proxy/recording", "page/status")
MAX_KEYS = 500
MAX_VIEWERS = 100
STATUS_KEY = "page/status"


class Viewer:
    """One open page: batches that wait to be sent to it."""

    def __init__(self, first: str) -> None:
        self.queue: asyncio.Queue[str] = asyncio.Queue(MAX_QUEUED_BATCHES)
        self.queue.put_nowait(first)
        self.messages: frozenset[str] = frozenset()

    def request_messages(self, text: str) -> None:
        """Take the messages it wants to see, a JSON list; what does not exist is left out."""
        try:
            names = msgspec.json.decode(text, type=list[str])
        except msgspec.MsgspecError:
            # A viewer that speaks nonsense is not worth an error.
            return
        self.messages = frozenset(
            name for name in names[:MOST_MESSAGES] if name == RANGES or find_layout(name)
        )


class Feed:
    """Samples in from any thread, batches out on the loop's."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._past: dict[str, deque[bytes]] = {}
        self._fresh: dict[str, deque[bytes]] = {}
        self._events: deque[tuple[str, bytes]] = deque(maxlen=MAX_EVENTS)
        self._unsent: deque[tuple[str, bytes]] = deque(maxlen=MAX_EVENTS)
        self._viewers: set[Viewer] = set()

    def add_sample(self, key: str, payload: bytes) -> None:
        """Note one sample; `key` is the one below the run's prefix."""
        try:
            msgspec.json.decode(payload)
        except msgspec.DecodeError:
            return  # it would spoil the whole batch
        with self._lock:
            if key in EVENT_KEYS:
                self._events.append((key, payload))
                self._unsent.append((key, payload))
            # A run that makes up keys must not fill the memory.
            elif key in self._past or len(self._past) < MAX_KEYS:
                past = CURVE_SAMPLES if key.startswith(CURVE_KEYS) else 1
                burst = 1 if key in STATE_KEYS else SAMPLES_PER_TICK
                self._past.setdefault(key, deque(maxlen=past)).append(payload)
                self._fresh.setdefault(key, deque(maxlen=burst)).append(payload)

    def set_status(self, state: object) -> None:
        """Tell the viewers how the page itself is doing."""
        self.add_sample(STATUS_KEY, msgspec.json.encode(state))

    def clear_run(self) -> None:
        """Drop what belongs to a run that is over; the status stays."""
        with self._lock:
            self._past = {key: data for key, data in self._past.items() if key == STATUS_KEY}
            self._fresh.clear()
            self._events.clear()
            self._unsent.clear()

    def add_viewer(self) -> Viewer:
        """A viewer more; it is told everything that is known first.

        Raises
        ------
        ConfigError
            If there are too many.
        """
        if len(self._viewers) >= MAX_VIEWERS:
            raise ConfigError(f"the page has {MAX_VIEWERS} viewers already; close one")
        # The picture first: batches alone would start in the middle.
        viewer = Viewer(self._snapshot())
        self._viewers.add(viewer)
        return viewer

    def remove_viewer(self, viewer: Viewer) -> None:
        """A viewer less."""
        self._viewers.discard(viewer)

    @property
    def viewers(self) -> int:
        """How many pages are open."""
        return len(self._viewers)

    def requested_messages(self) -> list[str]:
        """The messages that viewers want to see, as many as a proxy will show."""
        wanted: set[str] = set()
        # A copy: viewers come and go on the loop's thread meanwhile.
        for viewer in tuple(self._viewers):
            wanted |= viewer.messages
        return sorted(wanted)[:MOST_MESSAGES]

    def tick(self) -> None:
        """Give every viewer what came since the last tick."""
        # The lock for the moment of the exchange only: the bus pushes from other threads.
        with self._lock:
            samples = order_samples(self._unsent, self._fresh)
            self._unsent.clear()
            self._fresh.clear()
        if not samples:
            return
        batch = encode_batch(samples)
        for viewer in self._viewers:
            # It has lost batches: the whole picture puts it right again.
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
    listed: Iterable[tuple[str, bytes]], samples: dict[str, deque[bytes]]
) -> list[tuple[str, bytes]]:
    """States first, because they say which run and time the rest belongs to."""
    flat = [(key, payload) for key, payloads in samples.items() for payload in payloads]
    states = [sample for sample in flat if sample[0] in STATE_KEYS]
    return [*states, *listed, *(sample for sample in flat if sample[0] not in STATE_KEYS)]


def encode_batch(samples: list[tuple[str, bytes]]) -> str:
    """Samples as JSON: a list of [key, value]."""
    # The values are JSON already and are put in as they are.
    parts = [f"[{msgspec.json.encode(key).decode()},{data.decode()}]" for key, data in samples]
    return f"[{','.join(parts)}]"
