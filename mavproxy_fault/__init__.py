"""A MAVLink proxy that applies scripted and live faults and writes down what it did.

Bytes come in, become frames, pass the faults that are active, and leave as bytes. From Python:
`Proxy`, `AsyncProxy`, `LiveFault`, `Run`, `run` and `ConfigError`; each is loaded when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavproxy_fault.api.async_proxy import AsyncProxy
    from mavproxy_fault.api.flight_run import Run, run
    from mavproxy_fault.api.proxy_handle import LiveFault, Proxy
    from mavproxy_fault.documents.errors import ConfigError

__version__ = "0.1.0"
__all__ = ["AsyncProxy", "ConfigError", "LiveFault", "Proxy", "Run", "__version__", "run"]

# A command that parses its arguments must not pay for numpy, so a name is looked up on demand.
_HOMES = {
    "AsyncProxy": "mavproxy_fault.api.async_proxy",
    "ConfigError": "mavproxy_fault.documents.errors",
    "LiveFault": "mavproxy_fault.api.proxy_handle",
    "Proxy": "mavproxy_fault.api.proxy_handle",
    "Run": "mavproxy_fault.api.flight_run",
    "run": "mavproxy_fault.api.flight_run",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
