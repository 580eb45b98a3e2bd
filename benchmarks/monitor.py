"""How fast `monitor --log` is: times real time, with and without its parts, and stage by stage.

Run by hand: `python benchmarks/monitor.py [LOG] [--scenario FILE]`. Without a log the demo is flown
first. CPU time of one core, the median of `ROUNDS`; the command by the clock, a fresh process.
"""

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
import numpy as np

from analysis.detection import Detector
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.recordings.read_recordings import read_log
from analysis.results import encode_lines
from analysis.run.monitor_command import monitor_settings
from analysis.samples.block import EPHEMERIS, EPOCH, FIX, IMU, IONOSPHERE, Block
from analysis.scoring.attitude_scoring import AttitudeConfig, AttitudeScorer
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.tlog import read_columns, read_records

ROUNDS = 9
COMMANDS = 2  # runs of the command, after one that is not counted
SHORT_FRAMES = 700
SCALE = np.eye(18) + 0.1
SPEED = "numpy.linalg.inv of 18 x 18, for scale"
Actions = dict[str, Callable[[], object]]
DEMO = Path(__file__).parents[1] / "simvehicle" / "scenario" / "demo.yaml"


def inverses() -> None:
    """Inversions of a matrix, to measure the machine's speed."""
    for _ in range(1000):
        np.linalg.inv(SCALE)


def median_s(actions: Actions) -> dict[str, float]:
    """CPU time of each, the median of some rounds, after one that compiles.

    They have their turns in each round, since the machine's speed may change: `inverses`, which are
    among them, are said to have taken from so long to so long.
    """
    found: dict[str, list[float]] = {name: [] for name in [*actions, SPEED]}
    turns: Actions = actions | {SPEED: inverses}
    for action in turns.values():
        action()
    for _ in range(ROUNDS):
        for name, action in turns.items():
            began = time.process_time()
            action()
            found[name].append(time.process_time() - began)
    least, most = min(found[SPEED]) * 1e3, max(found[SPEED]) * 1e3
    print(f"{SPEED}: {least:.0f} us in the fastest round, {most:.0f} in the slowest")
    return {name: median(spent) for name, spent in found.items()}


def watched(blocks: Iterator[Block] | list[Block], config: MonitorConfig) -> Monitor:
    """Everything but the files: samples to results, tally and JSON."""
    monitor = Monitor(config)
    for block in blocks:
        encode_lines(monitor.push(block))
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
    everything = "log to results, everything"
    whole: Actions = {
        everything: lambda: watched(read_log(log), config),
        "the same without attitude estimators": lambda: watched(
            read_log(log), with_estimators(config)
        ),
        "ranges and IMU only": lambda: watched(only_ranges(read_log(log)), with_estimators(config)),
    }
    steps: Actions = {
        "columns of the log": lambda: read_columns(log),
        "samples": lambda: list(read_log(log)),
        "detector": lambda: stepped(Detector(config.detector), blocks),
        "other sensors": lambda: stepped(NavigationDetector(config.detector), blocks),
        "attitude": lambda: stepped(AttitudeScorer(config.attitude), blocks),
    }
    spent = median_s(whole | steps)
    print("\n| what | CPU s | times real time |\n|---|---:|---:|")
    for name in whole:
        print(f"| {name} | {spent[name]:.3f} | {span_s / spent[name]:.0f} |")
    stages = {name: spent[name] for name in steps}
    stages["samples"] -= stages["columns of the log"]
    stages["other sensors"] -= stages["detector"]
    stages["the rest: tally, order, JSON"] = spent[everything] - sum(stages.values())
    print("\n| stage | CPU s | share | us per epoch |\n|---|---:|---:|---:|")
    for name, stage_s in stages.items():
        per_us = stage_s / max(epochs, 1) * 1e6
        print(f"| {name} | {stage_s:.3f} | {stage_s / spent[everything]:.0%} | {per_us:.0f} |")


def only_ranges(blocks: Iterator[Block]) -> list[Block]:
    """IMU, epochs and broadcasts."""
    kinds = (IMU, EPOCH, EPHEMERIS, IONOSPHERE)
    return [block.where(np.isin(block.kind, kinds)) for block in blocks]


def command(log: Path, scenario: Path) -> None:
    """The command as a user types it the second time, when Python's bytecode and the machine code
    are on the disk; a log of a second shows what is start-up."""
    line = [sys.executable, "-m", "mavproxy_fault.cli", "monitor", "--zenoh", "off"]
    line += ["--scenario", str(scenario), "--log"]
    with tempfile.TemporaryDirectory() as folder:
        short = Path(folder) / "short.tlog"
        records = ((t_us, raw) for t_us, raw, _ in islice(read_records(log), SHORT_FRAMES))
        short.write_bytes(b"".join(tlog.log_record(*record) for record in records))
        runs = {
            "a second of it: start-up": [str(short)],
            "no files": [str(log)],
            "with results and report": [str(log), "--out", folder + "/out"],
        }
        kept = os.environ | {"PYTHONPYCACHEPREFIX": folder + "/bytecode"}
        kept.pop("PYTHONDONTWRITEBYTECODE", None)
        for name, arguments in runs.items():
            took_s = []
            for _ in range(1 + COMMANDS):
                shutil.rmtree(folder + "/out", ignore_errors=True)
                began = time.monotonic()
                subprocess.run(
                    [*line, *arguments], check=False, stdout=subprocess.DEVNULL, env=kept
                )
                took_s.append(time.monotonic() - began)
            print(f"| `mavproxy-fault monitor --log`, {name} | {min(took_s[1:]):.2f} s |")


def main() -> None:
    """Fly if there is no log, then measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", nargs="?", type=Path)
    parser.add_argument("--scenario", type=Path, default=DEMO)
    args = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder:
        log: Path | None = args.log
        if log is None:
            line = [sys.executable, "-m", "mavproxy_fault.cli", "run", "--zenoh", "off"]
            subprocess.run([*line, "--out", folder + "/demo"], check=False)
            log = Path(folder) / "demo" / "received.tlog"
        config, _ = monitor_settings(str(args.scenario), None)
        measure(log, config)
        print("\n| by the clock, from start to end of the process | |\n|---|---:|")
        command(log, args.scenario)


if __name__ == "__main__":
    main()
