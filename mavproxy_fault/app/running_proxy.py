"""Client side of live control: finds a running proxy on Zenoh and queries it."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import ANY_RUN, Bus, check_run_name, open_bus, running_proxies


@contextmanager
def join_run(args: argparse.Namespace) -> Iterator[Bus]:
    """Open Zenoh for the run named by `args`, or for the only run.

    Raises
    ------
    ConfigError
        If there is no router or run, or several runs and none is named.
    """
    if args.run is not None:
        check_run_name(args.run)
    # Opened for any run first, to find out which exist.
    with open_bus(args.zenoh, run=ANY_RUN, config_file=args.zenoh_config) as bus:
        bus.run = only_run(bus.list_components()) if args.run is None else args.run
        yield bus


def query_run(bus: Bus, what: str, payload: bytes = b"") -> Any:
    """Return a run's reply to the query `@ctl/<what>`.

    Raises
    ------
    ConfigError
        If the proxy refuses or does not reply.
    """
    return msgspec.json.decode(bus.query(f"@ctl/{what}", payload)[0])


def only_run(alive: Sequence[str]) -> str:
    """Return the run of the only proxy, given the liveliness keys of all components.

    Raises
    ------
    ConfigError
        If there is none or more than one.
    """
    runs = running_proxies(alive)
    if len(runs) != 1:
        found = f"{len(runs)} proxies are running: {', '.join(runs)}" if runs else "no proxy runs"
        raise ConfigError(f"{found}; " + ("choose one by --run" if runs else "start one"))
    return runs[0]
