"""`mavproxy-fault inject`: set, change or clear a fault on a running proxy, over the bus."""

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import near
from mavproxy_fault.faults.registry import fault_class, known_faults
from mavproxy_fault.links.bus import open_bus, running_proxies
from mavproxy_fault.schedule.entries import parse_entry
from mavproxy_fault.schedule.presets import preset_names

ANY = "*"


def main(args: argparse.Namespace) -> int:
    """Send one request and say what the proxy made of it."""
    # Exactly one of the two.
    if (args.fault is None) == (args.clear is None):
        raise ConfigError("inject: takes either FAULT or --clear ID; see `mavproxy-fault faults`")
    what, data = request(args)
    # A bus is opened for any run first: which ones there are is asked on it.
    with open_bus(args.zenoh, run=args.run or ANY, config_file=args.zenoh_config) as bus:
        bus.run = args.run or only_run(bus.who())
        for reply in bus.ask(f"@ctl/{what}", msgspec.json.encode(data)):
            print(json.dumps(json.loads(reply)))
    return 0


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
        raise ConfigError(f"inject: {there}; " + ("name one by --run" if runs else "start one"))
    return runs[0]


def request(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """The key below `@ctl/` and its payload; the entry is checked before it is sent.

    Raises
    ------
    ConfigError
        If the fault does not exist, or lacks something.
    """
    if args.clear is not None:
        # `all` is a word of the command, not an id that a fault could have.
        what = "schedule/stop" if args.clear == "all" else f"fault/{args.clear}/disarm"
        return what, {}
    several = args.target.split(",") if args.target is not None else None
    entry = live_entry(args.fault, several, args.value, {"for_s": args.for_s})
    return f"fault/{args.id or args.fault}/arm", entry


def live_entry(
    fault: str,
    target: str | Sequence[str] | None,
    value: float | None,
    keys: Mapping[str, Any],
) -> dict[str, Any]:
    """A fault or preset by name as the entry of a schedule, checked; `keys` are its further ones.

    Raises
    ------
    ConfigError
        If the fault does not exist, or lacks something.
    """
    if fault_class(fault) is None and fault not in preset_names():
        known = near(fault, [*known_faults(), *preset_names()])
        raise ConfigError(f"inject: {fault} is neither fault nor preset; {known}")
    # A preset of the same name only where nothing of it is changed.
    unchanged = target is None and value is None
    as_preset = fault in preset_names() and (unchanged or fault_class(fault) is None)
    entry: dict[str, Any] = {"preset" if as_preset else "fault": fault}
    if target is not None:
        several = [target] if isinstance(target, str) else list(target)
        # A list of one is written as the name itself, as people do.
        entry["target"] = several if len(several) > 1 else several[0]
    if value is not None:
        # `3.0` from the command line is 3 to faults that count.
        entry["value"] = int(value) if float(value).is_integer() else value
    entry |= {key: given for key, given in keys.items() if given is not None}
    # Checked here too: the answer of the proxy would come without a line to look at.
    parse_entry(entry, "inject")
    return entry
