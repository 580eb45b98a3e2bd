"""A proxy in this process, whose event loop runs in its own thread."""

import contextlib
import socket
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy.random  # noqa: F401  or the first draw of a fault would delay a frame

from mavproxy_fault.api.proxy_observer import ProxyObserver
from mavproxy_fault.app.proxy_command import link_roles, open_links
from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.server import Server
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.edit_log import EditLog
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule

# Chosen: far above the loop's normal shutdown time; a hung thread must not block the caller.
SHUTDOWN_TIMEOUT_S = 10.0


class LocalProxy:
    """A proxy that serves its links until it is closed.

    Parameters
    ----------
    master, outs : str and sequence of str
        Connection strings of the vehicle and of the other endpoints.
    schedule : Schedule
        The scripted faults.
    logdir : Path or None
        Folder for the tlogs and labels.
    zenoh : str
        `off`, `auto` or an address, as of `mavproxy-fault proxy`.
    """

    def __init__(
        self,
        master: str,
        outs: Sequence[str],
        schedule: Schedule,
        logdir: Path | None = None,
        zenoh: str = "off",
    ) -> None:
        self.observer = ProxyObserver()
        # Links first: callers read their addresses before any traffic.
        self._links = open_links(master, outs)
        self.addresses = [link.name for link in self._links]
        engine, tape = Engine(schedule), CaptureBuffer() if logdir else None
        core = Core(link_roles(self._links), engine, tape=tape)
        named = [{"name": role.name, "direction": role.direction} for role in core.links]
        session = {"seed": schedule.seed, "schedule": engine.save(), "inject": True, "links": named}
        recorder = Recorder(logdir, session) if logdir else None
        self._server = Server(self._links, core, tape=tape, recorder=recorder)
        journal = EditLog(core, tape)
        control = LiveControl(engine, folders=None if zenoh == "off" else ())  # None: any file
        self._live = LiveSession(control, self._server.edit_time, journal, self.observer)
        self._live.open_bus(zenoh)
        # Before the thread starts, so that nothing is shared during the set-up.
        self._server.prepare()
        self._server.join(self._live)
        self._failure: BaseException | None = None
        self._wake, self._woken = socket.socketpair()
        # A daemon thread, so that a program that never closes its proxy can still exit.
        self._thread = threading.Thread(target=self._run, name="mavproxy-fault", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._server.run(self._woken)
        except Exception as error:  # raised in the thread of the next caller
            self._failure = error

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

    def refresh(self) -> None:
        """Update the labels."""
        self._check()
        # In the loop's thread, since the core has no locks.
        self._live.do(self._server.record)

    def _check(self) -> None:
        if self._failure is not None:
            raise RuntimeError("the proxy's loop has failed") from self._failure
        if not self._thread.is_alive():
            raise ConfigError("the proxy is closed; use it inside its `with` block")

    def close(self) -> None:
        """End the loop, the recording and the links."""
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
