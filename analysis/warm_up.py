"""`warm-up`: compile all kernels now, instead of when a command first needs them.

Short flights, searches and reports run in a temporary folder: they call the same functions as
users do, so no list of kernels is needed. A wheel's build runs this too (`hatch_build.py`).
"""

import argparse
import contextlib
import io
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from analysis import commands
from analysis.processes import spawn_context
from mavproxy_fault.app.command_parser import add_option
from mavproxy_fault.documents.errors import ConfigError

SENSORS = """
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
"""
ATTITUDE = "attitude: {estimators: [ekf, complementary, mahony, inverse-model]}"
# The two differ in what has kernels of its own: the kind of vehicle, raw ranges or a receiver's
# position, air data or vision.
SCENARIOS = {
    "fixedwing": f"""
duration_s: 6
start: {{height_m: 100}}
mission: [{{shape: eight}}]
environment: {{gusts: light}}
sensors: {SENSORS}
  airspeed: {{preset: mpxv5004dp, rate_hz: 50}}
gnss: {{rate_hz: 5, systems: [GPS, Galileo]}}
schedule:
  faults:
    - {{fault: bias, target: PSEUDORANGE.G12, value: 50, at_s: 2, for_s: 2}}
    - {{fault: bias, target: HIL_SENSOR.xgyro, value: 1, at_s: 4, for_s: 1}}
monitor: {{{ATTITUDE}, fusion: {{compare: true}}}}
""",
    "multirotor": f"""
duration_s: 4
start: {{height_m: 30}}
vehicle: {{kind: multirotor, parameters: iris}}
mission: [{{shape: eight, size_m: 60, height_m: 30, speed_mps: 4}}]
sensors: {SENSORS}
  gps: {{preset: consumer, rate_hz: 5}}
  vision: {{preset: visual-odometry, rate_hz: 30}}
""",
}
SEARCH = """
vehicle: aerosonde-2012
estimator: {estimator}
duration_s: 3
noise_draws: 2
mission: {{roll_deg: [0, 30], period_s: 8}}
faults:
  - {{fault: bias, target: HIL_SENSOR.xgyro, value: [-0.02, 0.02], at_s: 1, for_s: 1}}
"""
ESTIMATORS = ("ekf", "complementary", "mahony", "inverse-model")


Step = tuple[str, Callable[[], None]]
"""A part of the work: the name under which its duration is printed, and what does it."""


def add_warm_up(subparsers: Any) -> None:
    """`warm-up`: compile now what commands would compile at first use."""
    parser = subparsers.add_parser("warm-up", help="compile all kernels now, once")
    help = "compile into DIR, for all processors that wheels support"
    add_option(parser, "--portable DIR", help)
    parser.set_defaults(main=main)


def main(args: argparse.Namespace) -> int:
    """Carry out the command."""
    if args.portable is not None:
        _aim_at_baseline(args.portable)
    with TemporaryDirectory(prefix="mavproxy-fault-") as folder:
        chains = _chains(Path(folder))
        # Whichever comes second to a function waits for the other, and loads it.
        workers = min(len(chains), os.cpu_count() or 1)
        with ProcessPoolExecutor(workers, spawn_context()) as pool:
            list(pool.map(_carry_out_chain, chains))
    return 0


def _aim_at_baseline(folder: str) -> None:
    """Let numba and the processes that are started compile for the baseline, into a folder."""
    from mavproxy_fault.numerics.baseline import BASELINE, runs_baseline

    if not runs_baseline():
        raise ConfigError(
            "warm-up --portable: this processor cannot run the code that it would compile"
        )
    os.environ |= {
        "MAVPROXY_FAULT_CACHE": str(Path(folder).resolve()),
        "NUMBA_CPU_NAME": BASELINE,  # read when numba is imported, which nothing here has done yet
        "NUMBA_CPU_FEATURES": "",  # those of that name and no more
    }


def _chains(folder: Path) -> list[list[Step]]:
    """Chains of steps that together call all compiled code; each chain runs in order."""
    for name, text in SCENARIOS.items():
        (folder / f"{name}.yaml").write_text(text)
    for name in ESTIMATORS:
        (folder / f"{name}.yaml").write_text(SEARCH.format(estimator=name))
    log = folder / "fixedwing" / "received.tlog"
    longest = [
        _step("fixedwing", folder, "run", "--zenoh", "off"),
        _step("monitor", folder, "monitor", "--zenoh", "off", "--log", str(log), file=False),
        _step("report", folder, "report", str(log), file=False),
    ]
    searches = [
        _step(name, folder, "search", "--budget", "8", "--workers", "1") for name in ESTIMATORS
    ]
    other = [_step("multirotor", folder, "run", "--zenoh", "off")]
    proxied: list[Step] = [
        ("the proxy's machine code", _make_object_file),
        ("stretches", partial(_make_stretches, folder / "multirotor.yaml")),
    ]
    return [longest, searches, other, proxied]


def _step(name: str, folder: Path, *words: str, file: bool = True) -> Step:
    """A command that writes into a folder of its name, of a file of its name if it takes one."""
    line = [*words, "--out", str(folder / name), *([str(folder / f"{name}.yaml")] if file else [])]
    return f"{words[0]} {name}" if file else name, partial(_carry_out, line)


def _make_object_file() -> None:
    from mavproxy_fault.compiled import object_file

    object_file.make()


def _make_stretches(scenario: Path) -> None:
    from analysis.autopilots.stretches import open_stretches
    from analysis.run.proxied_flight import ProxiedFlight
    from mavproxy_fault.compiled.passage import new_passage
    from mavproxy_fault.schedule.entries import Schedule
    from simvehicle.hil.hil_frames import HilPacker
    from simvehicle.scenario.scenario_file import read_scenario

    flight = ProxiedFlight(read_scenario(scenario), Schedule(0, ()))
    # Made, not flown: for that an autopilot would have to answer.
    simulation = flight.simulation
    passage = new_passage(flight.core, flight.capture)
    open_stretches(simulation, HilPacker(simulation.board), passage)


def _carry_out_chain(chain: Sequence[Step]) -> None:
    """Run steps one after the other, and print how long each took."""
    for name, work in chain:
        begun_s = time.monotonic()
        work()
        print(f"{name:24} {time.monotonic() - begun_s:5.0f} s", flush=True)


def _carry_out(words: list[str]) -> None:
    """Run one command as its user would, but without its output."""
    # Parsed like a user's line, so that each option has the default that users get.
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers()
    for add in (commands.add_run, commands.add_monitor, commands.add_report, commands.add_search):
        add(subparsers)
    args = parser.parse_args(words)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if args.main(args) == 2:  # a verdict of so short a flight says nothing
            raise ConfigError(f"{' '.join(words)}: failed; run it alone to see why")


if __name__ == "__main__":
    # While a wheel is built there is no `mavproxy-fault` command yet.
    top = argparse.ArgumentParser()
    add_warm_up(top.add_subparsers())
    sys.exit((args := top.parse_args(["warm-up", *sys.argv[1:]])).main(args))
