"""`mavproxy-fault inject`: set, change or clear a fault on a running proxy, over the bus."""

import argparse
import json
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import near
from mavproxy_fault.faults.registry import fault_class, known_faults
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.schedule.entries import parse_entry
from mavproxy_fault.schedule.presets import preset_names


def main(args: argparse.Namespace) -> int:
    """Send one request and say what the proxy made of it."""
    if (args.fault is None) == (args.clear is None):
        raise ConfigError("inject: takes either FAULT or --clear ID; see `mavproxy-fault faults`")
    what, data = request(args)
    with open_bus(args.zenoh, run=args.run) as bus:
        for reply in bus.ask(f"@ctl/{what}", msgspec.json.encode(data)):
            print(json.dumps(json.loads(reply)))
    return 0


def request(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """The key below `@ctl/` and its payload; the entry is checked before it is sent.

    Raises
    ------
    ConfigError
        If the fault does not exist, or lacks something.
    """
    if args.clear is not None:
        what = "schedule/stop" if args.clear == "all" else f"fault/{args.clear}/disarm"
        return what, {}
    if fault_class(args.fault) is None and args.fault not in preset_names():
        known = near(args.fault, [*known_faults(), *preset_names()])
        raise ConfigError(f"inject: {args.fault} is neither fault nor preset; {known}")
    plain = args.target is None and args.value is None
    as_preset = args.fault in preset_names() and (plain or fault_class(args.fault) is None)
    entry: dict[str, Any] = {"preset" if as_preset else "fault": args.fault}
    if args.target is not None:
        several = args.target.split(",")
        entry["target"] = several if len(several) > 1 else several[0]
    if args.value is not None:
        entry["value"] = int(args.value) if args.value.is_integer() else args.value
    if args.for_s is not None:
        entry["for_s"] = args.for_s
    parse_entry(entry, "inject")
    return f"fault/{args.id or args.fault}/arm", entry
