"""A proxy in this process: its loop runs in a thread of its own."""

import contextlib
import socket
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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

# Far above what the loop needs to end; a thread that hangs must not hang the caller.
SHUTDOWN_TIMEOUT_S = 10.0


class LocalProxy:
    """Serves its links until it is closed.

    Parameters
    ----------
    master, outs : str and sequence of str
        Connection strings of the vehicle and of the others.
    schedule : Schedule
        Faults that act by themselves.
    logdir : Path or None
        Where the tlogs and labels go.
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
        # Links first, as their addresses are asked for before anything flows.
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
        # Before the thread: nothing is shared while it is set up.
        self._server.prepare()
        self._server.join(self._live)
        self._failure: BaseException | None = None
        self._wake, self._woken = socket.socketpair()
        # A daemon: a program that forgets to close its proxy must still be able to end.
        self._thread = threading.Thread(target=self._run, name="mavproxy-fault", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._server.run(self._woken)
        except Exception as error:  # told to whoever asks next, in their own thread
            self._failure = error

    def query(self, what: str, payload: bytes = b"") -> Any:
        """The answer to a request for `@ctl/<what>`.

        Raises
        ------
        ConfigError
            If the request is refused.
        """
        # A failed loop would leave the caller waiting for an answer.
        self._check()
        return self._live.query(f"@ctl/{what}", payload)

    def refresh(self) -> None:
        """Bring labels up to this moment."""
        self._check()
        # In the loop's own thread: the core knows no locks.
        self._live.do(self._server.record)

    def _check(self) -> None:
        if self._failure is not None:
            raise RuntimeError("the proxy's loop has failed") from self._failure
        if not self._thread.is_alive():
            raise ConfigError("the proxy is closed; ask while its `with` block runs")

    def close(self) -> None:
        """End the loop, the recording and the links."""
        self._server.stop()
        with contextlib.suppress(OSError):
            # The loop may sleep for a tenth of a second; a byte wakes it.
            self._wake.send(b"!")
        # Joined before the links are closed: the loop may be reading them.
        self._thread.join(SHUTDOWN_TIMEOUT_S)
        for link in self._links:
            link.close()
        self._wake.close()
        self._woken.close()
        if self._failure is not None:
            raise RuntimeError("the proxy's loop has failed") from self._failure
