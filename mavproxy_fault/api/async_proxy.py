"""The proxy API for asyncio: the same calls as coroutines."""

import asyncio
from contextlib import AbstractAsyncContextManager
from typing import Any

from mavproxy_fault.api.proxy_handle import LiveFault, Proxy
from mavproxy_fault.wire.label import Label


class AsyncFault(AbstractAsyncContextManager["AsyncFault"]):
    """A `LiveFault` for `async with`."""

    def __init__(self, fault: LiveFault) -> None:
        self.id = fault.id
        self._fault = fault

    async def update(self, value: float) -> None:
        """Change its magnitude [the field's unit] while it acts."""
        # In a thread, since the call blocks until the proxy's loop has served it.
        await asyncio.to_thread(self._fault.update, value)

    async def clear(self) -> None:
        """End it."""
        await asyncio.to_thread(self._fault.clear)

    async def __aexit__(self, *raised: object) -> None:
        await self.clear()


class AsyncProxy(AbstractAsyncContextManager["AsyncProxy"]):
    """A `Proxy` for `async with`, with the same parameters; `attach` joins a running proxy."""

    def __init__(self, *args: Any, attach: str | None = None, **keywords: Any) -> None:
        self._proxy = Proxy(*args, **keywords) if attach is None else Proxy.attach(attach)

    @property
    def addresses(self) -> list[str]:
        """The links' connection strings, the vehicle's first."""
        return self._proxy.addresses

    async def fault(self, fault: str, **keywords: Any) -> AsyncFault:
        """As `Proxy.fault`."""
        return AsyncFault(await asyncio.to_thread(self._proxy.fault, fault, **keywords))

    async def labels(self) -> list[Label]:
        """As `Proxy.labels`."""
        return await asyncio.to_thread(lambda: self._proxy.labels)

    async def wait_for(self, condition: str, timeout_s: float = 5.0) -> None:
        """As `Proxy.wait_for`."""
        await asyncio.to_thread(self._proxy.wait_for, condition, timeout_s)

    async def __aexit__(self, *raised: object) -> None:
        await asyncio.to_thread(self._proxy.close)
