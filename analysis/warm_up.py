"""`warm-up`: make all machine code now, instead of when a command first needs it.

Short flights, searches and reports run in a folder that is thrown away: what they call is what
users call, so no list of kernels has to be kept. A wheel's build runs this too (`hatch_build.py`).
"""

import argparse
import contextlib
import io
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from analysis import commands
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
    "fixedwing.yaml": f"""
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
    "multirotor.yaml": f"""
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


def add_warm_up(subparsers: Any) -> None:
    """`warm-up`: compile now what commands would compile at first use."""
    parser = subparsers.add_parser("warm-up", help="make all machine code now, once")
    parser.add_argument(
        "--portable", metavar="DIR", help="into DIR, for all processors that wheels are made for"
    )
    parser.set_defaults(main=main)


def main(args: argparse.Namespace) -> int:
    """Carry out the command."""
    if args.portable is None:
        _warm_up()
        return 0
    with TemporaryDirectory(prefix="mavproxy-fault-") as draft:
        _aim_at_baseline(draft)
        _warm_up()
        print(f"the same in a fixed order {_seconds(lambda: _again(draft, args.portable)):5.0f} s")
    return 0


def _warm_up() -> None:
    """Call all that is compiled."""
    from mavproxy_fault.compiled import object_file

    print(f"the proxy's machine code {_seconds(object_file.make):5.0f} s", flush=True)
    with TemporaryDirectory(prefix="mavproxy-fault-") as folder:
        for words in _commands(Path(folder)):
            print(f"{words[0]:8} {Path(words[-1]).name:15}", end=" ", flush=True)
            print(f"{_seconds(partial(_carry_out, words)):5.0f} s", flush=True)


def _again(draft: str, folder: str) -> None:
    """What the flights have compiled, compiled anew into a folder, so that its bytes are fixed."""
    # Sets in what is pickled stand in the order of a hash.
    environment = {**os.environ, "MAVPROXY_FAULT_CACHE": folder, "PYTHONHASHSEED": "0"}
    command = [sys.executable, "-m", "analysis.recompile", draft]
    subprocess.run(command, env=environment, check=True)
    for file in Path(draft).rglob("*.o"):
        shutil.copy(file, Path(folder) / file.relative_to(draft))


def _aim_at_baseline(folder: str) -> None:
    """Let numba and the processes that are started compile for the baseline, into a folder."""
    from mavproxy_fault.numerics.baseline import BASELINE, runs_baseline

    if not runs_baseline():
        raise ConfigError(
            "warm-up --portable: this processor cannot run the code that it would make"
        )
    os.environ |= {
        "MAVPROXY_FAULT_CACHE": str(Path(folder).resolve()),
        "NUMBA_CPU_NAME": BASELINE,  # read when numba is imported, which nothing here has done yet
        "NUMBA_CPU_FEATURES": "",  # those of that name and no more
    }


def _commands(folder: Path) -> Iterator[list[str]]:
    """The command lines, between them all that calls compiled code; the last word names them."""
    for name, text in SCENARIOS.items():
        (folder / name).write_text(text)
        flight = folder / name.removesuffix(".yaml")
        yield ["run", "--zenoh", "off", "--out", str(flight), str(folder / name)]
    # It is there by now: the flight above was carried out before this generator went on.
    log = folder / "fixedwing" / "received.tlog"
    yield ["monitor", "--zenoh", "off", "--out", str(folder / "monitor"), "--log", str(log)]
    yield ["report", "--out", str(folder / "report"), str(log)]
    for estimator in ESTIMATORS:
        file = folder / f"{estimator}.yaml"
        file.write_text(SEARCH.format(estimator=estimator))
        out = folder / f"search-{estimator}"
        yield ["search", "--budget", "8", "--workers", "1", "--out", str(out), str(file)]


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
            raise ConfigError(f"{' '.join(words)}: failed; the command alone tells why")


def _seconds(work: Callable[[], None]) -> float:
    begun_s = time.monotonic()
    work()
    return time.monotonic() - begun_s


if __name__ == "__main__":
    # While a wheel is built there is no `mavproxy-fault` command yet.
    top = argparse.ArgumentParser()
    add_warm_up(top.add_subparsers())
    sys.exit((args := top.parse_args(["warm-up", *sys.argv[1:]])).main(args))
