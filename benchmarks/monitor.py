"""How fast `monitor --log` is: times real time, with and without its parts, and stage by stage.

Run by hand: `python benchmarks/monitor.py [LOG] [--scenario FILE]`. Without a log the demo is flown
first. CPU time of one core, the best of `ROUNDS`; the command itself by the clock, a fresh process.
"""

import argparse
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from analysis.block import EPHEMERIS, EPOCH, FIX, IMU, IONOSPHERE, Block
from analysis.compilation import light_compilation

with light_compilation():  # as the monitor does
    from analysis.attitude import AttitudeConfig, AttitudeScorer
    from analysis.fdi import Detector
    from analysis.monitor import Monitor
    from analysis.monitor_command import settings
    from analysis.pipeline import MonitorConfig
    from analysis.recordings import read_log
    from analysis.reference import References
    from analysis.results import encode_lines
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.tlog import read_columns, read_records

ROUNDS = 5
SHORT_FRAMES = 700
SCALE = np.eye(18) + 0.1
DEMO = Path(__file__).parents[1] / "simvehicle" / "scenarios" / "demo.yaml"


def best_s(action: Callable[[], object]) -> float:
    """CPU time of the fastest of some rounds, after one that compiles."""
    action()
    found = []
    for _ in range(ROUNDS):
        began = time.process_time()
        action()
        found.append(time.process_time() - began)
    return min(found)


def watched(blocks: Iterator[Block] | list[Block], config: MonitorConfig) -> Monitor:
    """Everything but the files: samples to results, tally and JSON."""
    monitor = Monitor(config)
    for block in blocks:
        encode_lines(monitor.block(block))
    return monitor


def stepped(step: Any, blocks: list[Block]) -> None:
    """One step of the pipeline alone."""
    state = step.new_state()
    for block in blocks:
        _, state = step.step(block, state)


def with_estimators(config: MonitorConfig, *names: str) -> MonitorConfig:
    """The configuration with other attitude estimators."""
    return msgspec.structs.replace(config, attitude=AttitudeConfig(estimators=names))


def measure(log: Path, config: MonitorConfig) -> None:
    """The two tables of one log."""
    blocks = list(read_log(log))
    monitor = watched(blocks, config)
    span_s = monitor.t_s
    epochs = sum(int((block.kind == EPOCH).sum()) for block in blocks)
    fixes = sum(int((block.kind == FIX).sum()) for block in blocks)
    imu = sum(int((block.kind == IMU).sum()) for block in blocks)
    print(
        f"\n{span_s:.0f} s of flight, {log.stat().st_size / 1e6:.1f} MB: {imu} IMU samples, "
        f"{epochs} epochs, {fixes} fixes, {sum(len(b.kind) for b in blocks)} samples in all\n"
    )
    rows: dict[str, Callable[[], object]] = {
        "log to results, everything": lambda: watched(read_log(log), config),
        "the same without attitude estimators": lambda: watched(
            read_log(log), with_estimators(config)
        ),
        "ranges and IMU only": lambda: watched(only_ranges(read_log(log)), with_estimators(config)),
    }
    print("| what | CPU s | times real time |\n|---|---:|---:|")
    whole_s = 0.0
    for name, action in rows.items():
        spent_s = best_s(action)
        whole_s = whole_s or spent_s
        print(f"| {name} | {spent_s:.3f} | {span_s / spent_s:.0f} |")
    stages: dict[str, float] = {
        "columns of the log": best_s(lambda: read_columns(log)),
        "samples": best_s(lambda: list(read_log(log))),
        "detector": best_s(lambda: stepped(Detector(config.detector), blocks)),
        "other sensors": best_s(lambda: stepped(References(config.detector), blocks)),
        "attitude": best_s(lambda: stepped(AttitudeScorer(config.attitude), blocks)),
    }
    stages["samples"] -= stages["columns of the log"]
    stages["other sensors"] -= stages["detector"]
    stages["the rest: tally, order, JSON"] = whole_s - sum(stages.values())
    print("\n| stage | CPU s | share | us per epoch |\n|---|---:|---:|---:|")
    for name, spent_s in stages.items():
        per_us = spent_s / max(epochs, 1) * 1e6
        print(f"| {name} | {spent_s:.3f} | {spent_s / whole_s:.0%} | {per_us:.0f} |")


def only_ranges(blocks: Iterator[Block]) -> list[Block]:
    """IMU, epochs and broadcasts."""
    kinds = (IMU, EPOCH, EPHEMERIS, IONOSPHERE)
    return [block.where(np.isin(block.kind, kinds)) for block in blocks]


def command(log: Path, scenario: Path) -> None:
    """The command as a user types it; a log of a second shows what is start-up."""
    line = [sys.executable, "-m", "mavproxy_fault.cli", "monitor", "--zenoh", "off"]
    line += ["--scenario", str(scenario), "--log"]
    with tempfile.TemporaryDirectory() as folder:
        short = Path(folder) / "short.tlog"
        records = ((t_us, raw) for t_us, raw, _ in islice(read_records(log), SHORT_FRAMES))
        tlog.write(short, records)
        runs = {
            "a second of it: start-up": [str(short)],
            "no files": [str(log)],
            "with results and report": [str(log), "--out", folder + "/out"],
        }
        for name, arguments in runs.items():
            began = time.monotonic()
            subprocess.run([*line, *arguments], check=False, stdout=subprocess.DEVNULL)
            print(f"| `mavproxy-fault monitor --log`, {name} | {time.monotonic() - began:.2f} s |")


def main() -> None:
    """Fly if there is no log, then measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", nargs="?", type=Path)
    parser.add_argument("--scenario", type=Path, default=DEMO)
    args = parser.parse_args()
    unit_s = best_s(lambda: [np.linalg.inv(SCALE) for _ in range(1000)]) / 1000
    print(
        f"{platform.processor() or platform.machine()}, Python {platform.python_version()}; "
        f"numpy.linalg.inv of 18 x 18, for scale: {unit_s * 1e6:.0f} us"
    )
    with tempfile.TemporaryDirectory() as folder:
        log: Path | None = args.log
        if log is None:
            line = [sys.executable, "-m", "mavproxy_fault.cli", "run", "--zenoh", "off"]
            subprocess.run([*line, "--out", folder + "/demo"], check=False)
            log = Path(folder) / "demo" / "received.tlog"
        config, _ = settings(str(args.scenario), None)
        measure(log, config)
        print("\n| by the clock, from start to end of the process | |\n|---|---:|")
        command(log, args.scenario)


if __name__ == "__main__":
    main()
