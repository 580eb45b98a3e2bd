"""Live control of a running proxy: the bus and RflySim's port, joined to the loop.

Zenoh answers queries on threads of its own, the engine belongs to the loop's thread. A request
therefore waits until the loop, woken by a socket, has carried it out.
"""

import contextlib
import gc
import itertools
import logging
import queue
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from typing import Any, Protocol

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import Bus, join_bus, open_bus, running_proxies
from mavproxy_fault.live.control import READ_ONLY_REQUESTS, LiveControl
from mavproxy_fault.live.edit_log import RFLYSIM, Edit, EditLog
from mavproxy_fault.live.rflysim import FIRST_PORT, PACKED
from mavproxy_fault.live.subscriptions import Watched
from mavproxy_fault.wire.label import Label

REQUEST_TIMEOUT_S = 3.0
ROUTER_CHECK_S = 1.0  # between two looks whether the bus has its router
DEFAULT_RUN = "live"
# Python's default of 5 ms would hold a frame up for as long.
SWITCH_INTERVAL_S = 2e-4
WATCH = "@ctl/watch"
PUBLISH_PERIOD_S = 0.04  # between two looks at what viewers watch
LABELS_KEPT = 100
LOG = logging.getLogger(__name__)


class Listener(Protocol):
    """Who is shown what a proxy says of itself; called in the loop's thread."""

    def add_labels(self, labels: Sequence[Label]) -> None:
        """Labels that began or ended."""

    def add_samples(self, samples: Sequence[Watched]) -> None:
        """Samples of watched messages."""


@contextlib.contextmanager
def short_thread_turns() -> Iterator[None]:
    """Let threads take short turns, so that one that imports or parses holds no frame up."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    # What they make would be looked through for garbage meanwhile, in one long turn.
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)
        if collects:
            gc.enable()


class LoopCalls:
    """Hands work of other threads to the loop, and its outcome back."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = (
            queue.SimpleQueue()
        )
        self._asking = 0  # threads that wait for an outcome
        self._changed = threading.Condition()
        self._closed = False
        self._reads, self._wakes = socket.socketpair()
        # Never waited on: a full socket has bytes enough to wake the loop.
        self._reads.setblocking(False)
        self._wakes.setblocking(False)

    def fileno(self) -> int:
        """Readable while something waits."""
        return self._reads.fileno()

    def call(self, act: Callable[[], Any]) -> Any:
        """Have the loop call `act`; its value, or what it raised.

        Raises
        ------
        ConfigError
            If the loop does not come to it in three seconds, or ends.
        """
        outcome: Future[Any] = Future()
        # Under the lock: nothing may be put in after `close` has emptied the queue.
        with self._changed:
            if self._closed:
                raise ConfigError("the proxy is ending; ask another")
            self._asking += 1
            self._waiting.put((act, outcome))
        with contextlib.suppress(BlockingIOError):
            self._wakes.send(b"!")
        try:
            return outcome.result(REQUEST_TIMEOUT_S)
        except TimeoutError:
            # Or the loop would carry out what nobody waits for any more.
            outcome.cancel()
            raise ConfigError(f"the proxy did not answer within {REQUEST_TIMEOUT_S} s") from None
        except CancelledError:
            raise ConfigError("the proxy has ended; ask another") from None
        finally:
            with self._changed:
                self._asking -= 1
                self._changed.notify_all()
            del outcome  # it holds the exception, which holds this frame and all that it refers to

    def serve(self) -> None:
        """Carry out all that waits; called by the loop."""
        # The bytes only wake; how many there are does not matter.
        with contextlib.suppress(BlockingIOError):
            while self._reads.recv(4096):
                pass
        while not self._waiting.empty():
            act, outcome = self._waiting.get()
            if not outcome.set_running_or_notify_cancel():
                continue  # whoever asked has given up
            try:
                outcome.set_result(act())
            # Also mistakes of ours: they belong to whoever asked, not to the loop.
            except Exception as error:
                outcome.set_exception(error)

    def close(self) -> None:
        """Refuse what still waits, and let those go who asked.

        Their threads are Zenoh's: one that came back to Python after the interpreter has ended
        would abort the process.
        """
        with self._changed:
            self._closed = True
        while not self._waiting.empty():
            self._waiting.get()[1].cancel()
        with self._changed:
            self._changed.wait_for(lambda: not self._asking, REQUEST_TIMEOUT_S)
        self._reads.close()
        self._wakes.close()


class LiveSession:
    """What a running proxy offers besides forwarding: control by the bus and by RflySim, and news.

    `now_us` tells the vehicle's time; `edit_log` takes every request that may change something;
    `listener` is shown, in this process, what the bus is told of labels and watched messages.
    """

    def __init__(
        self,
        control: LiveControl,
        now_us: Callable[[], int],
        journal: EditLog | None = None,
        listener: Listener | None = None,
    ) -> None:
        self.control = control
        self._listener = listener
        self._now_us = now_us
        self.edit_log = journal
        self._requests = LoopCalls()
        self._bus: Bus | None = None
        self._port: socket.socket | None = None
        self._config_file = ""
        self._successor = threading.Thread()  # that takes over from a router that ended
        self._look_s = self._show_s = 0.0
        self._shown = (0, 0)  # revision and changes of the engine

    def open_bus(self, zenoh: str, run: str | None = None, config_file: str = "") -> None:
        """Offer control on the bus: `auto` (the router here, or another's), `off`, or a URL.

        Without a name the run is called `live`, or `live-2` where there is one already.

        Raises
        ------
        ConfigError
            If a URL was given and cannot be used, or the run's name is another proxy's.
        """
        if zenoh == "off":
            return
        try:
            bus = join_bus(zenoh, run or DEFAULT_RUN, config_file)
        # Asked for by name it must work; `auto` may do without.
        except ConfigError as error:
            if zenoh != "auto" or config_file:
                raise
            LOG.warning("no live control: %s", error)
            return
        names = [] if bus.is_router else running_proxies(bus.list_components())
        if run in names:
            bus.close()
            raise ConfigError(f"--run {run} is another proxy's here; known: {', '.join(names)}")
        if bus.run in names:
            bus.run = next(name for n in itertools.count(2) if (name := f"live-{n}") not in names)
            LOG.warning("another proxy is called live: this one is --run %s", bus.run)
        self._config_file = config_file
        self.offer(bus)

    def offer(self, bus: Bus) -> None:
        """Answer queries on a bus that is open."""
        self._bus = bus
        bus.serve_queries("@ctl/**", self.query)
        bus.declare_alive("proxy")

    def _become_router(self, bus: Bus) -> None:
        """Be the router where the one there was has ended; unless another was faster."""
        with short_thread_turns(), contextlib.suppress(ConfigError):
            fresh = open_bus(bus.url, run=bus.run, router=True, config_file=self._config_file)
            self.do(lambda: self.offer(fresh))
            bus.close()

    def _look_after_bus(self, now_s: float) -> None:
        """See that somebody is the router; the proxies that have lost theirs try to be it."""
        # A look each second, and one successor at a time.
        if self._bus is None or now_s < self._look_s or self._successor.is_alive():
            return
        self._look_s = now_s + ROUTER_CHECK_S
        if not self._bus.is_connected:
            self._successor = threading.Thread(
                target=self._become_router, args=(self._bus,), daemon=True
            )
            self._successor.start()

    def open_rflysim(self, port: int = FIRST_PORT) -> int:
        """Listen for RflySim's packets on loopback; the port."""
        self._port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._port.setblocking(False)
        try:
            self._port.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:  # the second where it is no port at all
            self._port.close()
            raise ConfigError(f"--rflysim {port}: {error}; give a free UDP port") from None
        return int(self._port.getsockname()[1])

    def query(self, key: str, payload: bytes) -> Any:
        """The answer to a request of another thread, whose key ends in `@ctl/<what>`.

        Raises
        ------
        ConfigError
            If it is refused.
        """
        with short_thread_turns():
            # Reading and checking happens on the asker's thread: the loop must not wait for it.
            act = None if key.endswith(WATCH) else self.control.prepare(key, payload)
        return self.do(lambda: self._act(key, payload, act))

    def do(self, act: Callable[[], Any]) -> Any:
        """Have the loop's thread call `act`; its value, or what it raised."""
        return self._requests.call(act)

    def _act(self, key: str, payload: bytes, act: Callable[[int], Any] | None) -> Any:
        """Carry out one request in the loop's thread."""
        if act is None:
            return self.control.watch(payload, time.monotonic())
        # The time is taken in the loop's thread, just before the edit.
        t_us = self._now_us()
        if self.edit_log is not None and not key.endswith(READ_ONLY_REQUESTS):
            self.edit_log.note(key, payload, t_us)
        return act(t_us)

    def filenos(self) -> list[int]:
        """What the loop waits on besides its links."""
        ports = [] if self._port is None else [self._port.fileno()]
        return [self._requests.fileno(), *ports]

    def serve(self) -> None:
        """Carry out what has been asked for."""
        self._requests.serve()
        if self._port is None:
            return
        with contextlib.suppress(BlockingIOError):
            while True:
                # One byte more than a packet: what is longer is none.
                data = self._port.recv(PACKED.size + 1)
                t_us = self._now_us()
                if self.edit_log is not None:
                    self.edit_log.note(RFLYSIM, data, t_us)
                try:
                    self.control.packet(data, t_us)
                except ConfigError as error:
                    LOG.warning("RflySim: %s", error)

    def edits(self) -> list[Edit]:
        """What was asked for since the last call, for a recorder."""
        return [] if self.edit_log is None else self.edit_log.drain()

    def show(self, now_s: float) -> None:
        """Tell the bus at once of faults that begin, end or change, and what viewers watch."""
        if now_s < self._show_s:
            return
        self._show_s = now_s + PUBLISH_PERIOD_S
        self._look_after_bus(now_s)
        engine = self.control.engine
        # Only where something changed since the last look.
        if self._bus is not None and self._shown != (engine.revision, engine.changes):
            self._show_faults(self._bus)
        samples = self.control.watched(now_s)
        if samples and self._listener is not None:
            self._listener.add_samples(samples)
        if samples and self._bus is not None:
            self._bus.put("proxy/watched", msgspec.json.encode(samples), "mavfault.v1.Watched")

    def _show_faults(self, bus: Bus) -> None:
        engine = self.control.engine
        self._shown = (engine.revision, engine.changes)
        # The newest state is kept for those who join later.
        state = msgspec.json.encode(engine.state())
        bus.put("schedule/state", state, "mavfault.v1.ScheduleState", history=1)

    def publish(self, stats: object, labels: Sequence[Label]) -> None:
        """Tell the bus how the links and the faults are doing."""
        if self._listener is not None:
            self._listener.add_labels(labels)
        if self._bus is None:
            return
        self._bus.put("proxy/stats", msgspec.json.encode(stats), "mavfault.v1.EndpointStatistics")
        self._show_faults(self._bus)
        for label in labels:
            self._bus.put(
                "proxy/labels", msgspec.json.encode(label), "mavfault.v1.Label", LABELS_KEPT
            )

    def publish_recording(self, failing: str | None, lost: int) -> None:
        """Tell the bus whether what passes is being recorded."""
        if self._bus is not None:
            state = {"failing": failing, "lost_records": lost}
            self._bus.put("proxy/recording", msgspec.json.encode(state), "mavfault.v1.Recording")

    @property
    def url(self) -> str | None:
        """Where the bus is, once open."""
        return None if self._bus is None else self._bus.url

    @property
    def run(self) -> str | None:
        """What this proxy is called there."""
        return None if self._bus is None else self._bus.run

    @property
    def is_router(self) -> bool:
        """Whether the others hang on this proxy."""
        return self._bus is not None and self._bus.is_router

    def close(self) -> None:
        """Close the bus and the port; requests that wait are given up."""
        # The successor waits for this very thread to carry out its offer.
        while self._successor.is_alive():
            self._requests.serve()
            self._successor.join(0.01)
        self._requests.serve()
        self._requests.close()
        if self._bus is not None:
            self._bus.close()
        if self._port is not None:
            self._port.close()
