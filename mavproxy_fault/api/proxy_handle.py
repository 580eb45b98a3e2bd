"""The proxy of a test: faults that last as long as a `with` block, labels, and waiting."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import msgspec

from mavproxy_fault.api.proxy_observer import ProxyObserver
from mavproxy_fault.app.inject import live_entry
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import Schedule, parse_schedule, read_schedule
from mavproxy_fault.schedule.triggers import Condition
from mavproxy_fault.wire.label import Label


class ProxyAccess(Protocol):
    """Access to a proxy in a thread of this process or in another process."""

    observer: ProxyObserver
    addresses: list[str]

    def query(self, what: str, payload: bytes = b"") -> Any:
        """Return the reply to the query `@ctl/<what>`."""

    def refresh(self) -> None:
        """Update the labels, where the proxy can be asked to."""

    def close(self) -> None:
        """Release the proxy."""


class LiveFault:
    """An active fault; leaving its `with` block ends it."""

    def __init__(self, access: ProxyAccess, id: str) -> None:
        self.id = id
        self._access = access

    def update(self, value: float) -> None:
        """Change the magnitude [the field's unit] of the active fault."""
        self._access.query(f"fault/{self.id}/value", msgspec.json.encode({"value": value}))

    def clear(self) -> None:
        """End the fault; no effect if it has already ended."""
        # It may have ended after `for_s`.
        state = self._access.query("state")
        if any(fault["id"] == self.id for fault in state["faults"]):
            self._access.query(f"fault/{self.id}/disarm")

    def __enter__(self) -> "LiveFault":
        return self

    def __exit__(self, *raised: object) -> None:
        self.clear()


class Proxy:
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
        from mavproxy_fault.api.local_proxy import LocalProxy

        outs = [out] if isinstance(out, str) else list(out)
        folder = None if logdir is None else Path(logdir)
        self._access: ProxyAccess = LocalProxy(master, outs, _schedule(schedule), folder, zenoh)

    @classmethod
    def attach(cls, zenoh: str | None = None, *, run: str = "live") -> "Proxy":
        """Attach to a running proxy or run; `zenoh` is the address of its router.

        Raises
        ------
        ConfigError
            If it is not found.
        """
        from mavproxy_fault.api.remote_proxy import RemoteProxy

        # Bypasses `__init__`, which would open new links.
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
        self._access.query(f"fault/{id}/arm", msgspec.json.encode(entry))
        return LiveFault(self._access, id)

    def clear(self) -> None:
        """End every fault."""
        self._access.query("schedule/stop")

    @property
    def labels(self) -> list[Label]:
        """The applied faults: frames, times and magnitude of each."""
        self._access.refresh()
        return self._access.observer.labels

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
            return self._access.query("watch", msgspec.json.encode(names))

        self._access.observer.wait_for(parsed, timeout_s, watch)

    def close(self) -> None:
        """Close the links; an attached proxy keeps running."""
        self._access.close()

    def __enter__(self) -> "Proxy":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def _schedule(source: str | Path | dict[str, Any] | None) -> Schedule:
    if source is None:
        return Schedule()
    return parse_schedule(source) if isinstance(source, dict) else read_schedule(source)
