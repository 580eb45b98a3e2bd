"""`mavproxy-fault schedule`: the schedule of a running proxy, over Zenoh."""

import argparse
import json
from pathlib import Path

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.app.running_proxy import join_run, query_run
from mavproxy_fault.documents.errors import users_path
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.schedule.entries import parse_schedule

QUERIES = {
    "load": "schedule/begin", "save": "schedule/save", "clear": "schedule/stop", "state": "state",
}  # fmt: skip


def main(args: argparse.Namespace) -> int:
    """Run one action."""
    text = b""
    if args.action == "load":
        parse_schedule(read_document(args.file))  # reports errors with their lines
        text = Path(args.file).read_bytes()
    with join_run(args) as bus:
        reply = query_run(bus, QUERIES[args.action], text)
    if args.action == "load":
        loaded = reply["faults"]
        count = f"{len(loaded)} fault{'s' * (len(loaded) != 1)}"
        said = f"{count} loaded: {', '.join(loaded)}" if loaded else "no faults loaded"
        print_result(args, {"faults": loaded}, said)
    elif args.action == "save":
        _save(reply["anew"], args.file)
    elif args.action == "clear":
        said = "all faults cleared" if reply["cleared"] else "no faults to clear"
        print_result(args, {"cleared": reply["cleared"]}, said)
    else:
        print(json.dumps(reply, indent=2))
    return 0


def _save(text: str, file: str | None) -> None:
    if file is None:
        print(text, end="")
        return
    with users_path(file, "give another file"):
        Path(file).write_text(text, encoding="utf-8")
