"""The proxy of a test: faults that last as long as a `with` block, labels, and waiting."""

import contextlib
import socket
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import Any

import msgspec
import numpy.random  # noqa: F401  or the first draw of a fault would delay a frame

from mavproxy_fault.api.proxy_observer import ProxyObserver
from mavproxy_fault.app.inject import live_entry
from mavproxy_fault.app.proxy_command import make_server, open_links
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.edit_log import EditLog
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.live.subscriptions import Watched
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule, parse_schedule, read_schedule
from mavproxy_fault.schedule.triggers import Condition
from mavproxy_fault.wire.label import Label

# Chosen: far above the loop's normal shutdown time; a hung thread must not block the caller.
SHUTDOWN_TIMEOUT_S = 10.0


class LiveFault(contextlib.AbstractContextManager["LiveFault"]):
    """An active fault; leaving its `with` block ends it."""

    def __init__(self, proxy: "Proxy", id: str) -> None:
        self.id = id
        self._proxy = proxy

    def update(self, value: float) -> None:
        """Change the magnitude [the field's unit] of the active fault."""
        self._proxy.query(f"fault/{self.id}/value", msgspec.json.encode({"value": value}))

    def clear(self) -> None:
        """End the fault; no effect if it has already ended."""
        # It may have ended after `for_s`.
        state = self._proxy.query("state")
        if any(fault["id"] == self.id for fault in state["faults"]):
            self._proxy.query(f"fault/{self.id}/disarm")

    def __exit__(self, *raised: object) -> None:
        self.clear()


class Proxy(contextlib.AbstractContextManager["Proxy"]):
    """A proxy between a vehicle and other endpoints, open while its `with` block runs.

    Parameters
    ----------
    master : str
        The vehicle's connection string, such as `udpin:127.0.0.1:14540`.
    out : str or sequence of str
        Connection strings of ground stations etc. Port 0 selects a free port: see `addresses`.
    schedule : str, Path, dict or None
        A schedule file, or its content.
    logdir : str, Path or None
        Folder for `received.tlog`, `sent.tlog` and `labels.jsonl`.
    zenoh : str
        `off`, or `auto` so that `mavproxy-fault inject` and the page reach it.

    Raises
    ------
    ConfigError
        If a connection string or the schedule is wrong.
    """

    def __init__(
        self,
        master: str,
        out: str | Sequence[str],
        *,
        schedule: str | Path | dict[str, Any] | None = None,
        logdir: str | Path | None = None,
        zenoh: str = "off",
    ) -> None:
        given = _schedule(schedule)
        self._observer = ProxyObserver()
        # Links first: callers read their addresses before any traffic.
        self._links = open_links(master, [out] if isinstance(out, str) else out)
        self._addresses = [link.name for link in self._links]
        engine = Engine(given)
        session = {"seed": given.seed, "schedule": engine.save(), "inject": True}
        self._server = make_server(self._links, engine, logdir, session)
        control = LiveControl(engine, folders=None if zenoh == "off" else ())  # None: any file
        edits = EditLog(self._server.core, self._server.tape)
        self._live = LiveSession(control, self._server.edit_time, edits, self._observer)
        self._live.open_bus(zenoh)
        # Before the thread starts, so that nothing is shared during the set-up.
        self._server.prepare()
        self._server.join(self._live)
        self._failure: BaseException | None = None
        self._wake, self._woken = socket.socketpair()
        # A daemon thread, so that a program that never closes its proxy can still exit.
        self._thread = Thread(target=self._run, name="mavproxy-fault", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._server.run(self._woken)
        except Exception as error:  # raised in the thread of the next caller
            self._failure = error

    @staticmethod
    def attach(zenoh: str | None = None, *, run: str = "live") -> "Proxy":
        """Attach to a running proxy or run; `zenoh` is the address of its router.

        Raises
        ------
        ConfigError
            If it is not found.
        """
        return RemoteProxy(zenoh, run)

    @property
    def addresses(self) -> list[str]:
        """The links' connection strings, the vehicle's first; empty for an attached proxy."""
        return self._addresses

    def fault(
        self,
        fault: str,
        *,
        target: str | Sequence[str] | None = None,
        value: float | None = None,
        for_s: float | None = None,
        id: str | None = None,
        **parameters: Any,
    ) -> LiveFault:
        """Start a fault or preset now; it ends after `for_s` seconds or when it is cleared.

        Parameters
        ----------
        fault : str
            Its name, as listed by `mavproxy-fault faults list`.
        target : str or sequence of str, optional
            `MESSAGE.field`, or several.
        value : float, optional
            Its magnitude in the field's unit.
        for_s : float, optional
            Seconds of the vehicle's time.
        id : str, optional
            Its id in labels; default: the name of the fault.
        **parameters
            Further keys of the fault, as in a schedule.

        Raises
        ------
        ConfigError
            If the fault does not exist, or a key is wrong or missing.
        """
        entry = live_entry(fault, target, value, {"for_s": for_s, **parameters})
        # The same default as `mavproxy-fault inject`.
        id = id or fault
        self.query(f"fault/{id}/arm", msgspec.json.encode(entry))
        return LiveFault(self, id)

    def clear(self) -> None:
        """End every fault."""
        self.query("schedule/stop")

    @property
    def labels(self) -> list[Label]:
        """The applied faults: frames, times and magnitude of each."""
        self._refresh()
        return self._observer.labels

    def _refresh(self) -> None:
        self._check()
        # In the loop's thread, since the core has no locks.
        self._live.do(self._server.record)

    def wait_for(self, condition: str, timeout_s: float = 5.0) -> None:
        """Wait until a condition such as `armed` holds for the messages that the proxy sends.

        Parameters
        ----------
        condition : str
            As `when` in a schedule, for example `GPS_RAW_INT.fix_type < 3`.
        timeout_s : float
            Seconds of wall time.

        Raises
        ------
        ConfigError
            If the condition is not valid.
        TimeoutError
            If it does not become true in time.
        """
        try:
            parsed = Condition(condition)
        except ValueError as error:
            raise ConfigError(f"wait_for: {error}") from None

        # `wait_for` calls it repeatedly, since a subscription expires.
        def watch(names: list[str]) -> object:
            return self.query("watch", msgspec.json.encode(names))

        self._observer.wait_for(parsed, timeout_s, watch)

    def query(self, what: str, payload: bytes = b"") -> Any:
        """Return the reply to the query `@ctl/<what>`.

        Raises
        ------
        ConfigError
            If the query is refused.
        """
        # After a failure of the loop the caller would wait in vain.
        self._check()
        return self._live.query(f"@ctl/{what}", payload)

    def _check(self) -> None:
        if self._failure is not None:
            raise RuntimeError("the proxy's loop has failed") from self._failure
        if not self._thread.is_alive():
            raise ConfigError("the proxy is closed; use it inside its `with` block")

    def close(self) -> None:
        """End the loop, the recording and the links; an attached proxy keeps running."""
        self._server.stop()
        with contextlib.suppress(OSError):
            # A byte wakes the loop, which may sleep for 0.1 s.
            self._wake.send(b"!")
        # The thread ends before the links close, since it may be reading them.
        self._thread.join(SHUTDOWN_TIMEOUT_S)
        for link in self._links:
            link.close()
        self._wake.close()
        self._woken.close()
        if self._failure is not None:
            raise RuntimeError("the proxy's loop has failed") from self._failure

    def __exit__(self, *raised: object) -> None:
        self.close()


class RemoteProxy(Proxy):
    """A client of a running proxy over Zenoh; closing it does not stop the proxy."""

    def __init__(self, zenoh: str | None, run: str) -> None:
        self._observer = ProxyObserver()
        self._addresses = []
        self._bus = open_bus(zenoh, run=run)
        samples, label = msgspec.json.Decoder(list[Watched]), msgspec.json.Decoder(Label)
        self._bus.subscribe(
            "proxy/watched", lambda _, data: self._observer.add_samples(samples.decode(data))
        )
        self._bus.subscribe(
            "proxy/labels", lambda _, data: self._observer.add_labels([label.decode(data)])
        )

    def query(self, what: str, payload: bytes = b"") -> Any:
        """Return the reply to the query `@ctl/<what>`, as `Proxy.query`."""
        return msgspec.json.decode(self._bus.query(f"@ctl/{what}", payload)[0])

    def _refresh(self) -> None:
        """Do nothing: the proxy publishes its labels once a second."""

    def close(self) -> None:
        """Close the Zenoh session."""
        self._bus.close()


def _schedule(source: str | Path | dict[str, Any] | None) -> Schedule:
    if source is None:
        return Schedule()
    return parse_schedule(source) if isinstance(source, dict) else read_schedule(source)
