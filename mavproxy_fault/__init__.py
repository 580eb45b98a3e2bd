"""A MAVLink proxy that applies scripted and live faults and records what it did.

It splits received bytes into frames, applies the active faults and sends the result. Python API:
`run`, `campaign`, `search` and `report` with their results, `Proxy`, `AsyncProxy`, `LiveFault` and
`ConfigError`, each loaded at first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavproxy_fault.api.async_proxy import AsyncProxy
    from mavproxy_fault.api.command_results import (
        Campaign,
        Report,
        Search,
        campaign,
        report,
        search,
    )
    from mavproxy_fault.api.flight_run import Run, run
    from mavproxy_fault.api.proxy_handle import LiveFault, Proxy
    from mavproxy_fault.documents.errors import ConfigError

__version__ = "0.1.0"
__all__ = [
    "AsyncProxy", "Campaign", "ConfigError", "LiveFault", "Proxy", "Report", "Run", "Search",
    "__version__", "campaign", "report", "run", "search",
]  # fmt: skip

# Names are imported on demand, so that the command line starts without importing numpy.
_HOMES = {
    "AsyncProxy": "mavproxy_fault.api.async_proxy",
    **dict.fromkeys(
        ("Campaign", "Report", "Search", "campaign", "report", "search"),
        "mavproxy_fault.api.command_results",
    ),
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
