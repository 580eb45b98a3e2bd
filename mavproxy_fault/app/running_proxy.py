"""A proxy that runs, as the commands that speak to it find it on the bus."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import ANY_RUN, Bus, check_run_name, open_bus, running_proxies


@contextmanager
def join_run(args: argparse.Namespace) -> Iterator[Bus]:
    """The bus with the run that `args` name, or the only one there is.

    Raises
    ------
    ConfigError
        If there is no router, no such run, or a choice of several.
    """
    if args.run is not None:
        check_run_name(args.run)
    # A bus is opened for any run first: which ones there are is asked on it.
    with open_bus(args.zenoh, run=ANY_RUN, config_file=args.zenoh_config) as bus:
        bus.run = only_run(bus.list_components()) if args.run is None else args.run
        yield bus


def query_run(bus: Bus, what: str, payload: bytes = b"") -> Any:
    """The answer to one request of a run.

    Raises
    ------
    ConfigError
        If the proxy refuses, or does not answer.
    """
    return msgspec.json.decode(bus.query(f"@ctl/{what}", payload)[0])


def only_run(alive: Sequence[str]) -> str:
    """The run of the only proxy there is, by the keys of all components that are alive.

    Raises
    ------
    ConfigError
        If there are several, or none.
    """
    runs = running_proxies(alive)
    if len(runs) != 1:
        there = f"{len(runs)} proxies are there: {', '.join(runs)}" if runs else "no proxy is there"
        raise ConfigError(f"{there}; " + ("name one by --run" if runs else "start one"))
    return runs[0]
