"""The proxy as a test holds it: faults that live as long as a `with` block, labels, waiting."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import msgspec

from mavproxy_fault.api.proxy_observer import ProxyObserver
from mavproxy_fault.app.inject import live_entry
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import Schedule, parse_schedule, read_schedule
from mavproxy_fault.schedule.triggers import Condition
from mavproxy_fault.wire.label import Label


class ProxyAccess(Protocol):
    """Where the proxy runs: here in a thread, or in another process."""

    observer: ProxyObserver
    addresses: list[str]

    def query(self, what: str, payload: bytes = b"") -> Any:
        """The answer to a request for `@ctl/<what>`."""

    def refresh(self) -> None:
        """Bring labels up to this moment, where that is possible."""

    def close(self) -> None:
        """Let go of it."""


class LiveFault:
    """A fault that acts from now on; leaving its `with` block ends it."""

    def __init__(self, access: ProxyAccess, id: str) -> None:
        self.id = id
        self._access = access

    def update(self, value: float) -> None:
        """Change its magnitude [the field's unit] while it acts."""
        self._access.query(f"fault/{self.id}/value", msgspec.json.encode({"value": value}))

    def clear(self) -> None:
        """End it; ending one that has ended by itself does nothing."""
        # Ended by itself, by `for_s`: nothing to end.
        state = self._access.query("state")
        if any(fault["id"] == self.id for fault in state["faults"]):
            self._access.query(f"fault/{self.id}/disarm")

    def __enter__(self) -> "LiveFault":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.clear()


class Proxy:
    """A proxy between a vehicle and others, for as long as its `with` block runs.

    Parameters
    ----------
    master : str
        The vehicle's connection string, such as `udpin:127.0.0.1:14540`.
    out : str or sequence of str
        Those of ground stations and other programs. Port 0 is any free port: see `addresses`.
    schedule : str, Path, dict or None
        A file of faults, or the same as a dictionary.
    logdir : str, Path or None
        Where `received.tlog`, `sent.tlog` and `labels.jsonl` go.
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
        from mavproxy_fault.api.local_proxy import LocalProxy

        outs = [out] if isinstance(out, str) else list(out)
        folder = None if logdir is None else Path(logdir)
        self._access: ProxyAccess = LocalProxy(master, outs, _schedule(schedule), folder, zenoh)

    @classmethod
    def attach(cls, zenoh: str | None = None, *, run: str = "live") -> "Proxy":
        """The proxy or run that is running already; `zenoh` is its address on the bus.

        Raises
        ------
        ConfigError
            If there is none.
        """
        from mavproxy_fault.api.remote_proxy import RemoteProxy

        # Without `__init__`, which would open links of its own.
        proxy = cls.__new__(cls)
        proxy._access = RemoteProxy(zenoh, run)
        return proxy

    @property
    def addresses(self) -> list[str]:
        """The links' connection strings, the vehicle's first; empty for an attached proxy."""
        return self._access.addresses

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
        """Let a fault or preset act from now on, until it is cleared or `for_s` seconds are over.

        Parameters
        ----------
        fault : str
            Its name, as `mavproxy-fault faults list` shows it.
        target : str or sequence of str, optional
            `MESSAGE.field`, or several.
        value : float, optional
            Its magnitude in the field's unit.
        for_s : float, optional
            Seconds of the vehicle's time.
        id : str, optional
            Its name in labels; by default that of the fault.
        **parameters
            The fault's own further keys, as in a schedule.

        Raises
        ------
        ConfigError
            If there is no such fault, or a key is wrong or missing.
        """
        entry = live_entry(fault, target, value, {"for_s": for_s, **parameters})
        # The same default as the command's.
        id = id or fault
        self._access.query(f"fault/{id}/arm", msgspec.json.encode(entry))
        return LiveFault(self._access, id)

    def clear(self) -> None:
        """End every fault."""
        self._access.query("schedule/stop")

    @property
    def labels(self) -> list[Label]:
        """What every fault really did: frames, times, magnitude."""
        self._access.refresh()
        return self._access.observer.labels

    def wait_for(self, condition: str, timeout_s: float = 5.0) -> None:
        """Return once a condition holds for what leaves the proxy, such as `armed`.

        Parameters
        ----------
        condition : str
            As the `when` of a schedule, such as `GPS_RAW_INT.fix_type < 3`.
        timeout_s : float
            Seconds of wall time.

        Raises
        ------
        ConfigError
            If the condition cannot be read.
        TimeoutError
            If it does not come true in time.
        """
        try:
            parsed = Condition(condition)
        except ValueError as error:
            raise ConfigError(f"wait_for: {error}") from None

        # Asked again and again by `wait_for`: a watch is a lease.
        def watch(names: list[str]) -> object:
            return self._access.query("watch", msgspec.json.encode(names))

        self._access.observer.wait_for(parsed, timeout_s, watch)

    def close(self) -> None:
        """Close the links; an attached proxy goes on."""
        self._access.close()

    def __enter__(self) -> "Proxy":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _schedule(given: str | Path | dict[str, Any] | None) -> Schedule:
    if given is None:
        return Schedule()
    return parse_schedule(given) if isinstance(given, dict) else read_schedule(given)
