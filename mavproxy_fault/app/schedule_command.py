"""`mavproxy-fault schedule`: the schedule of a running proxy, over Zenoh."""

import argparse
import json
from pathlib import Path

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.app.running_proxy import join_run, query_run
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.schedule.entries import parse_schedule


def main(args: argparse.Namespace) -> int:
    """Run one action."""
    if args.action == "load":
        parse_schedule(read_document(args.file))  # reports errors with their lines
        text = Path(args.file).read_bytes()
        with join_run(args) as bus:
            loaded = query_run(bus, "schedule/begin", text)["faults"]
        count = f"{len(loaded)} fault{'s' * (len(loaded) != 1)}"
        said = f"{count} loaded: {', '.join(loaded)}" if loaded else "no faults loaded"
        print_result(args, {"faults": loaded}, said)
    elif args.action == "save":
        with join_run(args) as bus:
            _save(query_run(bus, "schedule/save")["anew"], args.file)
    elif args.action == "clear":
        with join_run(args) as bus:
            cleared = query_run(bus, "schedule/stop")["cleared"]
        said = "all faults cleared" if cleared else "no faults to clear"
        print_result(args, {"cleared": cleared}, said)
    else:
        with join_run(args) as bus:
            print(json.dumps(query_run(bus, "state"), indent=2))
    return 0


def _save(text: str, file: str | None) -> None:
    if file is None:
        print(text, end="")
        return
    try:
        Path(file).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{file}: {error.strerror}; give another file") from None
