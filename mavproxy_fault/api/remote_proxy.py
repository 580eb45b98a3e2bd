"""A proxy in another process, controlled over Zenoh."""

import json
from collections.abc import Callable
from typing import Any

import msgspec

from mavproxy_fault.api.proxy_observer import ProxyObserver
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.live.subscriptions import Watched
from mavproxy_fault.wire.label import Label


class RemoteProxy:
    """A client of a running proxy; closing it does not stop the proxy."""

    def __init__(self, zenoh: str | None, run: str) -> None:
        self.observer = ProxyObserver()
        self.addresses: list[str] = []
        self._bus = open_bus(zenoh, run=run)
        self._bus.subscribe("proxy/watched", _decoded(list[Watched], self.observer.add_samples))
        self._bus.subscribe(
            "proxy/labels", _decoded(Label, lambda label: self.observer.add_labels([label]))
        )

    def query(self, what: str, payload: bytes = b"") -> Any:
        """Return the reply to the query `@ctl/<what>`.

        Raises
        ------
        ConfigError
            If the query is refused or no proxy replies.
        """
        return json.loads(self._bus.query(f"@ctl/{what}", payload)[0])

    def refresh(self) -> None:
        """Do nothing: the proxy publishes its labels once a second."""

    def close(self) -> None:
        """Close the Zenoh session."""
        self._bus.close()


def _decoded(kind: Any, deliver: Callable[[Any], None]) -> Callable[[str, bytes], None]:
    """Return a subscriber that decodes JSON payloads of a type."""
    decoder = msgspec.json.Decoder(kind)
    return lambda key, payload: deliver(decoder.decode(payload))
