"""`mavproxy-fault inject`: set, change or clear a fault on a running proxy, over the bus."""

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from mavproxy_fault.app.running_proxy import join_run, query_run
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import read_yaml
from mavproxy_fault.faults.registry import fault_class, known_faults
from mavproxy_fault.live.bus_types import ScheduleState
from mavproxy_fault.schedule.cross_checks import check_id
from mavproxy_fault.schedule.entries import parse_entry
from mavproxy_fault.schedule.presets import preset_names


def main(args: argparse.Namespace) -> int:
    """Send one request and say what the proxy made of it."""
    # Exactly one of the three.
    if [args.fault is None, args.clear is None, not args.list].count(False) != 1:
        raise ConfigError(
            "inject: takes one of FAULT, --clear ID and --list; see `mavproxy-fault faults`"
        )
    if args.list:
        with join_run(args) as bus:
            print(format_fault_table(query_run(bus, "state")))
        return 0
    what, data = build_request(args)
    with join_run(args) as bus:
        print(json.dumps(query_run(bus, what, msgspec.json.encode(data))))
    return 0


def format_fault_table(state: ScheduleState) -> str:
    """The faults of a run, a line each, with seconds from the schedule's start."""
    rows = [("ID", "STATE", "FAULT", "FROM", "UNTIL", "FRAMES", "ON")]
    t0_us = state["t0_us"] or 0
    for fault in state["faults"]:
        begin, end = fault.get("start_us"), fault.get("end_us")
        rows.append(
            (
                fault["id"],
                fault["state"],
                fault.get("preset") or fault["fault"],
                "" if begin is None else f"{(begin - t0_us) * 1e-6:.1f}",
                "" if end is None else f"{(end - t0_us) * 1e-6:.1f}",
                str(fault.get("frames", 0)),
                ", ".join(fault.get("targets", [])),
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(text.ljust(w) for text, w in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines) if len(rows) > 1 else "no faults"


def build_request(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """The key below `@ctl/` and its payload; the entry is checked before it is sent.

    Raises
    ------
    ConfigError
        If the fault does not exist, or lacks something.
    """
    if args.clear is not None:
        if args.clear != "all":
            check_id(args.clear, "--clear")
        # `all` is a word of the command, not an id that a fault could have.
        what = "schedule/stop" if args.clear == "all" else f"fault/{args.clear}/disarm"
        return what, {}
    id = args.fault if args.id is None else args.id
    check_id(id, "inject")
    several = args.target.split(",") if args.target is not None else None
    keys = {"for_s": args.for_s, **parse_settings(args.set)}
    entry = live_entry(args.fault, several, args.value, keys)
    return f"fault/{id}/arm", entry


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Further keys of an entry, from KEY=VALUE with the value as in a schedule.

    Raises
    ------
    ConfigError
        If one is not such a pair, or its value is no YAML.
    """
    found: dict[str, Any] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.isidentifier():
            raise ConfigError(f"--set: {pair} is no KEY=VALUE; such as probability=0.2")
        found[key] = read_yaml(f"{key}: {value}", "--set").data[key]
    return found


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
        known = suggest_known(fault, [*known_faults(), *preset_names()])
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
