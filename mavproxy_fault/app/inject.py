"""`mavproxy-fault inject`: set, change or clear a fault on a running proxy over Zenoh."""

import argparse
import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import msgspec

from mavproxy_fault.app.catalogue import fault_and_preset_names
from mavproxy_fault.app.command_result import open_console, plain_table, print_result
from mavproxy_fault.app.running_proxy import join_run, query_run
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import read_yaml
from mavproxy_fault.faults.registry import fault_class
from mavproxy_fault.live.bus_types import ScheduleState
from mavproxy_fault.schedule.cross_checks import check_id
from mavproxy_fault.schedule.entries import parse_entry
from mavproxy_fault.schedule.presets import preset_names


def main(args: argparse.Namespace) -> int:
    """Send one request and print the proxy's reply."""
    # Exactly one of the three.
    if [args.fault is None, args.clear is None, not args.list].count(False) != 1:
        raise ConfigError(
            "inject: give one of FAULT, --clear ID and --list; see `mavproxy-fault faults list`"
        )
    what, data = ("state", {}) if args.list else build_request(args)
    with join_run(args) as bus:
        reply = query_run(bus, what, msgspec.json.encode(data))
    if args.list:
        print_result(args, reply["faults"], partial(show_faults, reply))
    else:
        print_result(args, reply, json.dumps(reply))
    return 0


def show_faults(state: ScheduleState) -> None:
    """Print the faults of a run as a table, with times in seconds from the schedule's start."""
    numbers = ("from s", "to s", "frames")
    table = plain_table("id", "state", "fault", *numbers, "target", right=numbers)
    for fault in state["faults"]:
        begin, end = (
            "" if t_us is None else f"{(t_us - (state['t0_us'] or 0)) * 1e-6:.1f}"
            for t_us in (fault.get("start_us"), fault.get("end_us"))
        )
        words = fault["id"], fault["state"], fault.get("preset") or fault["fault"], begin, end
        frames, targets = str(fault.get("frames", 0)), ", ".join(fault.get("targets", []))
        table.add_row(*words, frames, targets)
    open_console().print(table if state["faults"] else "no faults")


def build_request(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """Return the key below `@ctl/` and the payload, after a check of the entry.

    Raises
    ------
    ConfigError
        If the fault does not exist, or a key is wrong or missing.
    """
    if args.clear is not None:
        if args.clear != "all":
            check_id(args.clear, "--clear")
        # `all` is reserved and never the id of a fault.
        what = "schedule/stop" if args.clear == "all" else f"fault/{args.clear}/disarm"
        return what, {}
    id = args.fault if args.id is None else args.id
    check_id(id, "inject")
    targets = args.target.split(",") if args.target is not None else None
    keys = {"for_s": args.for_s, **parse_settings(args.set)}
    entry = live_entry(args.fault, targets, args.value, keys)
    return f"fault/{id}/arm", entry


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Parse KEY=VALUE arguments to keys of an entry; values are YAML as in a schedule.

    Raises
    ------
    ConfigError
        If an argument is not such a pair, or its value is not YAML.
    """
    parsed: dict[str, Any] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.isidentifier():
            raise ConfigError(f"--set: {pair} is not KEY=VALUE; give for example probability=0.2")
        parsed[key] = read_yaml(f"{key}: {value}", "--set").data[key]
    return parsed


def live_entry(
    fault: str,
    target: str | Sequence[str] | None,
    value: float | None,
    keys: Mapping[str, Any],
) -> dict[str, Any]:
    """Build and check the schedule entry of a fault or preset; `keys` are its further keys.

    Raises
    ------
    ConfigError
        If the fault does not exist, or a key is wrong or missing.
    """
    if fault_class(fault) is None and fault not in preset_names():
        known = suggest_known(fault, fault_and_preset_names())
        raise ConfigError(f"inject: {fault} is neither a fault nor a preset; {known}")
    # The preset, if a fault has the same name, only without target and value.
    unchanged = target is None and value is None
    as_preset = fault in preset_names() and (unchanged or fault_class(fault) is None)
    entry: dict[str, Any] = {"preset" if as_preset else "fault": fault}
    if target is not None:
        targets = [target] if isinstance(target, str) else list(target)
        # A single target is written without a list.
        entry["target"] = targets if len(targets) > 1 else targets[0]
    if value is not None:
        # Some faults take an integer, but the command line parses a float.
        entry["value"] = int(value) if float(value).is_integer() else value
    entry |= {key: given for key, given in keys.items() if given is not None}
    # Checked here too, so that errors appear before anything is sent.
    parse_entry(entry, "inject")
    return entry
