"""`warm-up`: make all machine code now, instead of when a command first needs it.

Short flights, searches and reports run in a folder that is thrown away: what they call is what
users call, so no list of kernels has to be kept. A wheel's build runs this too (`hatch_build.py`).
"""

import argparse
import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from analysis import commands
from mavproxy_fault.documents.errors import ConfigError

SENSORS = """
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
"""
ATTITUDE = "attitude: {estimators: [ekf, complementary, mahony, inverse-model]}"
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


def main(args: argparse.Namespace) -> int:
    """Carry out the command."""
    from mavproxy_fault.compiled import object_file

    print(f"the proxy's machine code {_seconds(object_file.make):5.0f} s", flush=True)
    with tempfile.TemporaryDirectory(prefix="mavproxy-fault-") as folder:
        for words in _commands(Path(folder)):
            print(f"{words[0]:8} {Path(words[-1]).name:15}", end=" ", flush=True)
            print(f"{_seconds(lambda: _carry_out(words)):5.0f} s", flush=True)
    return 0


def _commands(folder: Path) -> Iterator[list[str]]:
    """The command lines, between them all that calls compiled code; the last word names them."""
    for name, text in SCENARIOS.items():
        (folder / name).write_text(text)
        flight = folder / name.removesuffix(".yaml")
        yield ["run", "--zenoh", "off", "--out", str(flight), str(folder / name)]
    log = folder / "fixedwing" / "received.tlog"
    yield ["monitor", "--out", str(folder / "monitor"), "--log", str(log)]
    yield ["report", "--out", str(folder / "report"), str(log)]
    for estimator in ESTIMATORS:
        file = folder / f"{estimator}.yaml"
        file.write_text(SEARCH.format(estimator=estimator))
        out = folder / f"search-{estimator}"
        yield ["search", "--budget", "8", "--workers", "1", "--out", str(out), str(file)]


def _carry_out(words: list[str]) -> None:
    """Run one command as its user would, but without its output."""
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers()
    for add in (commands.add_run, commands.add_monitor, commands.add_report, commands.add_search):
        add(subparsers)
    args = parser.parse_args(words)
    with contextlib.redirect_stdout(io.StringIO()):
        if args.main(args) == 2:  # a verdict of so short a flight says nothing
            raise ConfigError(f"{' '.join(words)}: failed; the command alone tells why")


def _seconds(work: Callable[[], None]) -> float:
    begun_s = time.monotonic()
    work()
    return time.monotonic() - begun_s


if __name__ == "__main__":
    sys.exit(main(argparse.Namespace()))
