"""Processor seconds that each kernel takes to compile, by a command's first use.

    python benchmarks/compile_costs.py run --zenoh off --out OUT

Runs the command with an empty cache and adds up numba's own "numba:compile" events in all of its
processes, without what a function compiles in turn. Prints a table by module.
"""

import json
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any


def main() -> None:
    """Run the command and print the table."""
    with tempfile.TemporaryDirectory() as cache:
        os.environ["MAVPROXY_FAULT_CACHE"] = cache
        record = Path(cache, "events.jsonl")
        listen(record)
        from mavproxy_fault.cli import main as command

        command(sys.argv[1:])
        seconds: Counter[str] = Counter()
        functions: Counter[str] = Counter()
        for line in record.read_text().splitlines():
            module, spent_s = json.loads(line)
            seconds[module] += spent_s
            functions[module] += 1
    print(f"{sum(seconds.values()):.1f} s, {sum(functions.values())} compiled forms")
    for module, spent_s in seconds.most_common():
        print(f"| {module} | {functions[module]} | {spent_s:.2f} |")


def listen(record: Path) -> None:
    """Append each compilation's module and seconds to a file; forks inherit this."""
    from numba.core import event

    file = record.open("a", buffering=1)
    begun: list[list[float]] = []

    class Compilations(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            begun.append([time.thread_time(), 0.0])

        def on_end(self, ended: Any) -> None:
            start_s, inner_s = begun.pop()
            spent_s = time.thread_time() - start_s
            if begun:
                begun[-1][1] += spent_s
            module = ended.data["dispatcher"].py_func.__module__
            file.write(
                json.dumps([module.split(".np")[0].split(".cpython")[0], spent_s - inner_s]) + "\n"
            )

    event.register("numba:compile", Compilations())


if __name__ == "__main__":
    main()
