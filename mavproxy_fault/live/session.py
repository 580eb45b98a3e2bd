"""Live control of a running proxy: connects Zenoh and RflySim's UDP port to the loop.

Zenoh handles queries in its own threads, but the engine belongs to the loop's thread. A query
therefore waits until the loop, woken by a socket, has applied it.
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

REQUEST_TIMEOUT_S = 3.0  # chosen: far above the loop's longest step
ROUTER_CHECK_S = 1.0  # interval between checks for the Zenoh router
DEFAULT_RUN = "live"
# Python's default of 5 ms would delay a frame by as much.
SWITCH_INTERVAL_S = 2e-4
WATCH = "@ctl/watch"
PUBLISH_PERIOD_S = 0.2  # between updates for viewers: each costs 0.3 ms, the page plays it evenly
LABELS_KEPT = 100
LOG = logging.getLogger(__name__)


class Listener(Protocol):
    """Receives the labels and samples of a proxy; called in the loop's thread."""

    def add_labels(self, labels: Sequence[Label]) -> None:
        """Receive labels that began or ended."""

    def add_samples(self, samples: Sequence[Watched]) -> None:
        """Receive samples of watched messages."""


@contextlib.contextmanager
def short_thread_turns() -> Iterator[None]:
    """Shorten the threads' time slices, so that imports and parsing do not delay frames."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    # A garbage collection would be one long slice.
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)
        if collects:
            gc.enable()


class LoopCalls:
    """Runs calls of other threads in the loop's thread and returns their results."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = (
            queue.SimpleQueue()
        )
        self._callers = 0  # number of threads that wait for a result
        self._changed = threading.Condition()
        self._closed = False
        self._reads, self._wakes = socket.socketpair()
        # Non-blocking: a full socket wakes the loop just as well.
        self._reads.setblocking(False)
        self._wakes.setblocking(False)

    def fileno(self) -> int:
        """Descriptor that is readable while a call waits."""
        return self._reads.fileno()

    def call(self, act: Callable[[], Any]) -> Any:
        """Run `act` in the loop's thread; return its value or raise its exception.

        Raises
        ------
        ConfigError
            If the loop does not run it within three seconds, or ends.
        """
        outcome: Future[Any] = Future()
        # Under the lock, since nothing may be queued after `close` has emptied the queue.
        with self._changed:
            if self._closed:
                raise ConfigError("the proxy is shutting down; start it again")
            self._callers += 1
            self._waiting.put((act, outcome))
        with contextlib.suppress(BlockingIOError):
            self._wakes.send(b"!")
        try:
            return outcome.result(REQUEST_TIMEOUT_S)
        except TimeoutError:
            # Cancelled, so that the loop does not run it after its caller has given up.
            outcome.cancel()
            raise ConfigError(f"no reply within {REQUEST_TIMEOUT_S:g} s; try again") from None
        except CancelledError:
            raise ConfigError("the proxy has ended; start it again") from None
        finally:
            with self._changed:
                self._callers -= 1
                self._changed.notify_all()
            del outcome  # breaks the reference cycle of exception and frame

    def serve(self) -> None:
        """Run all waiting calls; called by the loop."""
        # The bytes only wake the loop; their number is irrelevant.
        with contextlib.suppress(BlockingIOError):
            while self._reads.recv(4096):
                pass
        while not self._waiting.empty():
            act, outcome = self._waiting.get()
            if not outcome.set_running_or_notify_cancel():
                continue  # the caller has given up
            try:
                outcome.set_result(act())
            # Bugs included: the exception goes to the caller and must not end the loop.
            except Exception as error:
                outcome.set_exception(error)

    def close(self) -> None:
        """Cancel waiting calls and wait for their threads to return.

        These are Zenoh's threads: one that returned to Python after the interpreter's shutdown
        would abort the process.
        """
        with self._changed:
            self._closed = True
        while not self._waiting.empty():
            self._waiting.get()[1].cancel()
        with self._changed:
            self._changed.wait_for(lambda: not self._callers, REQUEST_TIMEOUT_S)
        self._reads.close()
        self._wakes.close()


class LiveSession:
    """Control of a running proxy over Zenoh and RflySim, and publication of its state.

    `bus` is None if Zenoh is off. `now_us` returns the vehicle's time; `edit_log` records every
    request that may change the schedule; `listener` receives, in this process, the labels and
    samples published on Zenoh.
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
        self.bus: Bus | None = None
        self._port: socket.socket | None = None
        self._config_file = ""
        self._successor = threading.Thread()  # takes over from a router that has ended
        self._router_check_s = self._publish_s = 0.0
        self._published = (0, 0)  # revision and changes of the engine

    def open_bus(self, zenoh: str, run: str | None = None, config_file: str = "") -> None:
        """Open live control on Zenoh: `auto` (become the router or join it), `off`, or a URL.

        The default name of the run is `live`, or `live-2` if that is taken.

        Raises
        ------
        ConfigError
            If a given URL cannot be used, or the run's name is taken.
        """
        bus = join_bus(zenoh, run or DEFAULT_RUN, config_file, without="no live control")
        if bus is None:
            return
        names = [] if bus.is_router else running_proxies(bus.list_components())
        if run in names:
            bus.close()
            raise ConfigError(f"--run {run} is taken; use a name other than {', '.join(names)}")
        if bus.run in names:
            bus.run = next(name for n in itertools.count(2) if (name := f"live-{n}") not in names)
            LOG.warning("the name live is taken: reach this proxy with --run %s", bus.run)
        self._config_file = config_file
        self.offer(bus)

    def offer(self, bus: Bus) -> None:
        """Answer queries on an open bus."""
        self.bus = bus
        bus.serve_queries("@ctl/**", self.query)
        bus.declare_alive("proxy")

    def _become_router(self, bus: Bus) -> None:
        """Become the router after it has ended, unless another proxy was faster."""
        with short_thread_turns(), contextlib.suppress(ConfigError):
            fresh = open_bus(bus.url, run=bus.run, router=True, config_file=self._config_file)
            self.do(lambda: self.offer(fresh))
            bus.close()

    def _check_router(self, now_s: float) -> None:
        """Check the connection to the router; without one, try to become the router."""
        # Once a second, and one attempt at a time.
        if self.bus is None or now_s < self._router_check_s or self._successor.is_alive():
            return
        self._router_check_s = now_s + ROUTER_CHECK_S
        if not self.bus.is_connected:
            self._successor = threading.Thread(
                target=self._become_router, args=(self.bus,), daemon=True
            )
            self._successor.start()

    def open_rflysim(self, port: int = FIRST_PORT) -> int:
        """Listen for RflySim's packets on loopback and return the port."""
        self._port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._port.setblocking(False)
        try:
            self._port.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:  # OverflowError: not a port number
            self._port.close()
            raise ConfigError(f"--rflysim {port}: {error}; give a free UDP port") from None
        return int(self._port.getsockname()[1])

    def query(self, key: str, payload: bytes) -> Any:
        """Answer a query of another thread, whose key ends in `@ctl/<what>`.

        Raises
        ------
        ConfigError
            If the query is refused.
        """
        with short_thread_turns():
            # Parsing and checking happen in the caller's thread, so the loop need not wait.
            act = None if key.endswith(WATCH) else self.control.prepare(key, payload)
        return self.do(lambda: self._act(key, payload, act))

    def do(self, act: Callable[[], Any]) -> Any:
        """Run `act` in the loop's thread; return its value or raise its exception."""
        return self._requests.call(act)

    def _act(self, key: str, payload: bytes, act: Callable[[int], Any] | None) -> Any:
        """Apply one query in the loop's thread."""
        if act is None:
            return self.control.watch(payload, time.monotonic())
        # The time is read in the loop's thread, just before the edit.
        t_us = self._now_us()
        if self.edit_log is not None and not key.endswith(READ_ONLY_REQUESTS):
            self.edit_log.note(key, payload, t_us)
        return act(t_us)

    def filenos(self) -> list[int]:
        """Descriptors that the loop waits on besides its links."""
        ports = [] if self._port is None else [self._port.fileno()]
        return [self._requests.fileno(), *ports]

    def serve(self) -> None:
        """Apply waiting queries and RflySim packets."""
        self._requests.serve()
        if self._port is None:
            return
        with contextlib.suppress(BlockingIOError):
            while True:
                # One byte more than a packet, to recognise longer datagrams.
                data = self._port.recv(PACKED.size + 1)
                t_us = self._now_us()
                if self.edit_log is not None:
                    self.edit_log.note(RFLYSIM, data, t_us)
                try:
                    self.control.packet(data, t_us)
                except ConfigError as error:
                    LOG.warning("RflySim: %s", error)

    def edits(self) -> list[Edit]:
        """Return the edits since the last call, for the recorder."""
        return [] if self.edit_log is None else self.edit_log.drain()

    def show(self, now_s: float) -> None:
        """Publish changes of faults and the samples of watched messages."""
        if now_s < self._publish_s:
            return
        self._publish_s = now_s + PUBLISH_PERIOD_S
        self._check_router(now_s)
        engine = self.control.engine
        # Only after a change.
        if self.bus is not None and self._published != (engine.revision, engine.changes):
            self._show_faults(self.bus)
        samples = self.control.watched(now_s)
        if samples and self._listener is not None:
            self._listener.add_samples(samples)
        if samples and self.bus is not None:
            self.bus.put("proxy/watched", msgspec.json.encode(samples), "mavfault.v1.Watched")

    def _show_faults(self, bus: Bus) -> None:
        engine = self.control.engine
        self._published = (engine.revision, engine.changes)
        # Late joiners receive the newest state.
        state = msgspec.json.encode(engine.state())
        bus.put("schedule/state", state, "mavfault.v1.ScheduleState", history=1)

    def publish(self, stats: object, labels: Sequence[Label]) -> None:
        """Publish the link statistics, the state of the faults and new labels."""
        if self._listener is not None:
            self._listener.add_labels(labels)
        if self.bus is None:
            return
        self.bus.put("proxy/stats", msgspec.json.encode(stats), "mavfault.v1.EndpointStatistics")
        self._show_faults(self.bus)
        for label in labels:
            self.bus.put(
                "proxy/labels", msgspec.json.encode(label), "mavfault.v1.Label", LABELS_KEPT
            )

    def publish_recording(self, failing: str | None, lost: int) -> None:
        """Publish the state of the recording."""
        if self.bus is not None:
            state = {"failing": failing, "lost_records": lost}
            self.bus.put("proxy/recording", msgspec.json.encode(state), "mavfault.v1.Recording")

    def close(self) -> None:
        """Close Zenoh and the port, and cancel waiting queries."""
        # The successor's thread waits for this thread to run its call.
        while self._successor.is_alive():
            self._requests.serve()
            self._successor.join(0.01)
        self._requests.serve()
        self._requests.close()
        if self.bus is not None:
            self.bus.close()
        if self._port is not None:
            self._port.close()
