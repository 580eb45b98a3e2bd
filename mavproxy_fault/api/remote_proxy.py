"""A proxy of another process, reached over the bus."""

import json
from collections.abc import Callable
from typing import Any

import msgspec

from mavproxy_fault.api.proxy_observer import ProxyObserver
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.live.subscriptions import Watched
from mavproxy_fault.wire.label import Label


class RemoteProxy:
    """A client of a running proxy; closing it leaves the proxy as it is."""

    def __init__(self, zenoh: str | None, run: str) -> None:
        self.observer = ProxyObserver()
        self.addresses: list[str] = []
        self._bus = open_bus(zenoh, run=run)
        self._bus.subscribe("proxy/watched", _decoded(list[Watched], self.observer.add_samples))
        self._bus.subscribe(
            "proxy/labels", _decoded(Label, lambda label: self.observer.add_labels([label]))
        )

    def query(self, what: str, payload: bytes = b"") -> Any:
        """The answer to a request for `@ctl/<what>`.

        Raises
        ------
        ConfigError
            If the request is refused, or nobody answers.
        """
        return json.loads(self._bus.query(f"@ctl/{what}", payload)[0])

    def refresh(self) -> None:
        """Nothing to do: the proxy publishes its labels once a second."""

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()


def _decoded(kind: Any, deliver: Callable[[Any], None]) -> Callable[[str, bytes], None]:
    """A subscriber that decodes JSON of a type."""
    decoder = msgspec.json.Decoder(kind)
    return lambda key, payload: deliver(decoder.decode(payload))
