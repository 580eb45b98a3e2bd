"""Live control of a running proxy: the bus and RflySim's port, joined to the loop.

Zenoh answers queries on threads of its own, the engine belongs to the loop's thread. A request
therefore waits until the loop, woken by a socket, has carried it out.
"""

import argparse
import contextlib
import logging
import queue
import select
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from mavproxy_fault.core import Core
from mavproxy_fault.errors import ConfigError
from mavproxy_fault.links.bus import Bus, open_bus

if TYPE_CHECKING:  # these cost start-up time; they come while frames are forwarded already
    from mavproxy_fault.control import Control
    from mavproxy_fault.engine import Engine
    from mavproxy_fault.wire.label import Label

PATIENCE_S = 3.0
LABELS_KEPT = 100
LOG = logging.getLogger(__name__)


class Requests:
    """Hands work of other threads to the loop, and its outcome back."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = (
            queue.SimpleQueue()
        )
        self._reads, self._wakes = socket.socketpair()
        self._reads.setblocking(False)
        self._wakes.setblocking(False)

    def fileno(self) -> int:
        """Readable while something waits."""
        return self._reads.fileno()

    def ask(self, act: Callable[[], Any]) -> Any:
        """Have the loop call `act`; its value, or what it raised.

        Raises
        ------
        ConfigError
            If the loop does not come to it in three seconds.
        """
        outcome = self.put(act)
        try:
            return outcome.result(PATIENCE_S)
        except TimeoutError:
            outcome.cancel()
            raise ConfigError(f"the proxy did not answer within {PATIENCE_S} s") from None

    def put(self, act: Callable[[], Any]) -> Future[Any]:
        """Have the loop call `act` some time."""
        outcome: Future[Any] = Future()
        self._waiting.put((act, outcome))
        with contextlib.suppress(OSError):  # full: it is awake; closed: it is over
            self._wakes.send(b"!")
        return outcome

    def serve(self) -> None:
        """Carry out all that waits; called by the loop."""
        with contextlib.suppress(BlockingIOError):
            while self._reads.recv(4096):
                pass
        while not self._waiting.empty():
            act, outcome = self._waiting.get()
            if not outcome.set_running_or_notify_cancel():
                continue  # whoever asked has given up
            try:
                outcome.set_result(act())
            except Exception as error:
                outcome.set_exception(error)

    def close(self) -> None:
        """Close the sockets."""
        self._reads.close()
        self._wakes.close()


class Live:
    """What a running proxy offers besides forwarding: control by the bus and by RflySim, and news.

    `now_us` tells the vehicle's time. `control` must be there before anything is opened.
    """

    def __init__(self, now_us: Callable[[], int], control: "Control | None" = None) -> None:
        self.control = control
        self._now_us = now_us
        self._requests = Requests()
        self._poll = select.epoll()
        self._poll.register(self._requests.fileno(), select.EPOLLIN)
        self._bus: Bus | None = None
        self._port: socket.socket | None = None

    def load(self, join: Callable[[], None]) -> None:
        """Import what control needs in the background, then have the loop call `join`."""

        def imports() -> None:
            import zenoh  # noqa: F401

            self._requests.put(join)

        threading.Thread(target=imports, daemon=True).start()

    def open_bus(self, zenoh: str, run: str = "live") -> None:
        """Offer control on the bus: `auto` (the router here, or another's), `off`, or a URL.

        Raises
        ------
        ConfigError
            If a URL was given and cannot be used.
        """
        if zenoh == "off":
            return
        url = None if zenoh == "auto" else zenoh
        try:
            self._bus = open_bus(url, run=run, router=True)
        except ConfigError as error:
            try:
                self._bus = open_bus(url, run=run)  # somebody else is the router already
            except ConfigError:
                if url is not None:
                    raise error from None
                LOG.warning("no live control: %s", error)
                return
        self._bus.answer("@ctl/**", self._answer)
        self._bus.alive("proxy")

    def open_rflysim(self, port: int) -> int:
        """Listen for RflySim's packets on loopback; the port."""
        self._port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._port.setblocking(False)
        try:
            self._port.bind(("127.0.0.1", port))
        except OSError as error:
            raise ConfigError(f"--rflysim {port}: {error}; give a free UDP port") from None
        self._poll.register(self._port.fileno(), select.EPOLLIN)
        return int(self._port.getsockname()[1])

    def _answer(self, key: str, payload: bytes) -> Any:
        assert self.control is not None
        act = self.control.answer
        return self._requests.ask(lambda: act(key, payload, self._now_us()))

    def watch(self, other: socket.socket) -> "Live":
        """Let `fileno` be readable when this socket is, too: a loop then waits on one thing."""
        self._poll.register(other.fileno(), select.EPOLLIN)
        return self

    def fileno(self) -> int:
        """Readable while there is something to carry out."""
        return self._poll.fileno()

    def serve(self) -> None:
        """Carry out what has been asked for, if anything."""
        if not self._poll.poll(0):
            return
        self._requests.serve()
        if self._port is None or self.control is None:
            return
        from mavproxy_fault.rflysim import PACKED

        with contextlib.suppress(BlockingIOError):
            while True:
                data = self._port.recv(PACKED.size + 1)
                try:
                    self.control.packet(data, self._now_us())
                except ConfigError as error:
                    LOG.warning("RflySim: %s", error)

    def publish(self, stats: object) -> None:
        """Tell the bus how the links and the faults are doing."""
        if self._bus is not None and self.control is not None:
            import msgspec

            self._bus.put("proxy/stats", msgspec.json.encode(stats))
            state = msgspec.json.encode(self.control.engine.state())
            self._bus.put("schedule/state", state, history=1)

    def tell(self, labels: "Sequence[Label]") -> None:
        """Tell the bus what has begun or ended."""
        if self._bus is None or not labels:
            return
        import msgspec

        for label in labels:
            data = msgspec.json.encode(label)
            self._bus.put("proxy/labels", data, "mavfault.v1.Label", LABELS_KEPT)

    @property
    def url(self) -> str | None:
        """Where the bus is, once open."""
        return None if self._bus is None else self._bus.url

    def close(self) -> None:
        """Close the bus and the port; requests that wait are given up."""
        self._requests.serve()
        if self._bus is not None:
            self._bus.close()
        if self._port is not None:
            self._port.close()
        self._requests.close()
        self._poll.close()


@contextlib.contextmanager
def live_control(args: argparse.Namespace, core: Core, engine: "Engine | None") -> Iterator[Live]:
    """The live control that the command line of `proxy` asks for, joined to a core.

    Without a schedule there is no engine yet; it is loaded while frames are forwarded already.
    """
    live = Live(lambda: core.clock.t_us)

    def join() -> None:
        from mavproxy_fault.control import Control
        from mavproxy_fault.engine import Engine
        from mavproxy_fault.rflysim import SHIPPED, read_map
        from mavproxy_fault.schedule import Schedule

        acting = engine or Engine(Schedule())
        if core.clock.t0_us is not None:
            acting.start_at(core.clock.t0_us)
        core.engine = acting
        ids = None if args.rflysim is None else read_map(args.rflysim_map or SHIPPED)
        live.control = core.control = Control(acting, allowed=not args.no_inject, rflysim=ids)
        live.open_bus(args.zenoh)
        if args.rflysim is not None:
            live.open_rflysim(args.rflysim)

    try:
        if engine is None and args.zenoh in ("auto", "off") and args.rflysim is None:
            live.load(join)
        else:
            join()
        yield live
    finally:
        live.close()
