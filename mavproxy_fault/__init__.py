"""A MAVLink proxy that applies scripted and live faults and records what it did.

It splits received bytes into frames, applies the active faults and sends the result. Python API:
`run`, `campaign`, `search`, `report` and `monitor` with their results, `Proxy`, `AsyncProxy`,
`LiveFault` and `ConfigError`, each loaded at first use. These names, and those of
`mavproxy_fault.estimators` and `mavproxy_fault.detectors`, change only with a new major version.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavproxy_fault.api.async_proxy import AsyncProxy
    from mavproxy_fault.api.command_calls import campaign, monitor, report, run, search
    from mavproxy_fault.api.proxy_handle import LiveFault, Proxy
    from mavproxy_fault.api.result_folders import Campaign, Report, Run, Search
    from mavproxy_fault.documents.errors import ConfigError

__version__ = "0.1.0"
__all__ = [
    "AsyncProxy", "Campaign", "ConfigError", "LiveFault", "Proxy", "Report", "Run", "Search",
    "__version__", "campaign", "monitor", "report", "run", "search",
]  # fmt: skip

# Names are imported on demand, so that the command line starts without importing numpy.
_HOMES = {
    "AsyncProxy": "mavproxy_fault.api.async_proxy",
    **dict.fromkeys(
        ("campaign", "monitor", "report", "run", "search"), "mavproxy_fault.api.command_calls"
    ),
    **dict.fromkeys(("Campaign", "Report", "Run", "Search"), "mavproxy_fault.api.result_folders"),
    "ConfigError": "mavproxy_fault.documents.errors",
    "LiveFault": "mavproxy_fault.api.proxy_handle",
    "Proxy": "mavproxy_fault.api.proxy_handle",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
