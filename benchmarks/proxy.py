"""Throughput, latency, loss and CPU of a MAVLink proxy, beside a plain forwarder in C.

    python benchmarks/proxy.py [--router PATH] [--rounds N] [--realtime]

HIL_SENSOR frames, one per UDP datagram, are sent to one port and received at another (`load.c`,
compiled here). mavproxy-fault runs with ten active faults, one of which changes every frame, and
with ten of which five do. The proxies take turns within each round, so that other load on the
machine affects them alike; medians of the rounds are printed as a Markdown table. `--router` adds
a mavlink-routerd; `--command NAME=COMMAND` any proxy, whose command gets `{master}` and `{out}` (or
`{in_port}` and `{out_port}`).
"""

import argparse
import os
import shlex
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
PROXY = f"{sys.executable} -m mavproxy_fault.cli proxy --zenoh off --master udpin:{{master}} "
PROXY += "--to udpout:{out}"
FAULTS = """\
seed: 1
faults:
  - {id: touches-each, fault: bias, target: HIL_SENSOR.xgyro, value: 0.1}
  - {id: two, fault: bias, target: ATTITUDE.roll, value: 0.1}
  - {id: three, fault: bias, target: GPS_RAW_INT.lat, value: 10}
  - {id: four, fault: drop, target: STATUSTEXT}
  - {id: five, fault: scale, target: VFR_HUD.alt, value: 2}
  - {id: six, fault: bias, target: SCALED_IMU.xacc, value: 10}
  - {id: seven, fault: stuck, target: SCALED_PRESSURE.press_abs}
  - {id: eight, fault: noise, target: HIL_GPS.lat, value: 10}
  - {id: nine, fault: delay, target: ODOMETRY, value: 0.1}
  - {id: ten, fault: drift, target: HIGHRES_IMU.xgyro, value: 0.1}
"""
FIVE_EACH = """\
seed: 1
faults:
  - id: segments
    fault: bias
    target: HIL_SENSOR.xgyro
    profile: {segments: [{at_s: 0, for_s: 1000000, start: {uniform: [0.1, 0.2]}, rate: 0.000001}]}
  - {id: noise, fault: noise, target: [HIL_SENSOR.xacc, HIL_SENSOR.yacc, HIL_SENSOR.zacc], value: 1}
  - {id: stuck, fault: freeze, target: HIL_SENSOR.abs_pressure}
  - {id: scale, fault: scale, target: [HIL_SENSOR.xmag, HIL_SENSOR.ymag], value: 1.3}
  - {id: drift, fault: drift, target: HIL_SENSOR.zgyro, value: 0.0001}
  - {id: six, fault: bias, target: SCALED_IMU.xacc, value: 10}
  - {id: seven, fault: stuck, target: SCALED_PRESSURE.press_abs}
  - {id: eight, fault: noise, target: HIL_GPS.lat, value: 10}
  - {id: nine, fault: delay, target: ODOMETRY, value: 0.1}
  - {id: ten, fault: drift, target: HIGHRES_IMU.xgyro, value: 0.1}
"""
DELAY = "faults: [{id: late, fault: delay, target: HIL_SENSOR, value: 0.0072}]\n"
SETTLE_S = 2.0  # mavproxy-fault loads live control in the first second
CASES = (
    ("64 in flight", "window", 64, 100_000),
    ("lockstep", "window", 1, 20_000),
    ("10,000/s", "rate", 10_000, 10_000),
    ("100,000/s", "rate", 100_000, 100_000),
)


class Outcome(NamedTuple):
    """One case on one proxy: frames, seconds, latencies in microseconds, CPU seconds."""

    sent: int
    received: int
    lost: int
    seconds: float
    p50_us: float
    p99_us: float
    p999_us: float
    cpu_s: float

    @property
    def rate_k(self) -> float:
        """Thousands of frames a second."""
        return self.received / self.seconds * 1e-3


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        port: int = place.getsockname()[1]
        return port


def cpu_s(process: subprocess.Popen[bytes]) -> float:
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Bench:
    """The compiled load generator and the ports of one run."""

    def __init__(self, folder: Path, realtime: bool) -> None:
        self.realtime = realtime
        self.prefix: tuple[str, ...] = ()
        self.load = self.compile(folder, "load")
        self.forwarder = self.compile(folder, "forwarder")
        self.folder = folder

    @staticmethod
    def compile(folder: Path, name: str) -> str:
        """Build one of the C files beside this one."""
        target = folder / name
        subprocess.run(["cc", "-O2", "-o", target, HERE / f"{name}.c"], check=True)
        return str(target)

    @contextmanager
    def running(self, command: str) -> Iterator[tuple[subprocess.Popen[bytes], int, int]]:
        """A proxy that forwards and is warm."""
        in_port, out_port = free_port(), free_port()
        text = command.format(
            master=f"127.0.0.1:{in_port}",
            out=f"127.0.0.1:{out_port}",
            in_port=in_port,
            out_port=out_port,
        )
        process = subprocess.Popen(shlex.split(text), stdout=subprocess.DEVNULL)
        try:
            for _ in range(100):
                time.sleep(0.1)
                if self.measure(process, in_port, out_port, "rate", 100, 5).received == 5:
                    break
            else:
                raise SystemExit(f"no frame passes: {text}")
            time.sleep(SETTLE_S)
            if self.realtime:
                os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(10))
                self.prefix = ("chrt", "-f", "10")
            yield process, in_port, out_port
        finally:
            self.prefix = ()
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def measure(
        self,
        process: subprocess.Popen[bytes],
        in_port: int,
        out_port: int,
        mode: str,
        pace: int,
        count: int,
    ) -> Outcome:
        """One case."""
        before_s = cpu_s(process)
        words = [*self.prefix, self.load, in_port, out_port, mode, pace, count]
        said = subprocess.run(
            [str(word) for word in words], capture_output=True, check=True, text=True
        ).stdout.split()
        sent, received, lost = (int(word) for word in said[:3])
        seconds, p50_us, p99_us, p999_us = (float(word) for word in said[3:])
        used_s = cpu_s(process) - before_s
        return Outcome(sent, received, lost, seconds, p50_us, p99_us, p999_us, used_s)


def commands(args: argparse.Namespace, bench: Bench) -> dict[str, str]:
    """The proxies by name."""
    schedule = bench.folder / "ten.yaml"
    schedule.write_text(FAULTS)
    found = {"C forwarder": f"{bench.forwarder} {{in_port}} {{out_port}}"}
    if args.router:
        found["mavlink-router"] = f"{args.router} -t 0 -e {{out}} {{master}}"
    found["mavproxy-fault, no fault"] = PROXY
    found["mavproxy-fault, ten faults"] = f"{PROXY} --schedule {schedule}"
    five = bench.folder / "five.yaml"
    five.write_text(FIVE_EACH)
    found["mavproxy-fault, ten faults, five on each frame"] = f"{PROXY} --schedule {five}"
    found["mavproxy-fault, ten faults, --busy-poll"] = f"{PROXY} --schedule {schedule} --busy-poll"
    for text in args.command:
        name, _, command = text.partition("=")
        found[name] = command
    return found


def cold_row(bench: Bench) -> str:
    """Frames lost of 100,000 in the first second after the line `ready`."""
    lost = []
    for name, command in commands(argparse.Namespace(router=None, command=[]), bench).items():
        if not name.startswith("mavproxy-fault"):
            continue
        in_port, out_port = free_port(), free_port()
        text = command.format(master=f"127.0.0.1:{in_port}", out=f"127.0.0.1:{out_port}")
        process = subprocess.Popen(shlex.split(text), stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        outcome = bench.measure(process, in_port, out_port, "rate", 100_000, 100_000)
        lost.append(f"{name}: {outcome.lost}")
        process.send_signal(signal.SIGINT)
        process.communicate()
    return f"lost of 100,000 frames in the first second after `ready`: {'; '.join(lost)}"


def delay_row(bench: Bench) -> str:
    """Lateness of frames delayed by 7.2 ms, at 200 per second, and of frames without a delay."""
    schedule = bench.folder / "delay.yaml"
    schedule.write_text(DELAY)
    found = []
    late = f"{PROXY} --schedule {schedule}"
    for command in (PROXY, late, f"{late} --busy-poll"):
        with bench.running(command) as (process, in_port, out_port):
            bench.measure(process, in_port, out_port, "stamped", 200, 100)
            found.append(bench.measure(process, in_port, out_port, "stamped", 200, 1000))
    healthy, sleeping, polling = found
    return (
        f"at 200/s, not delayed: p50 {healthy.p50_us:.0f} us, p99 {healthy.p99_us:.0f} us; delayed "
        f"by 7.2 ms: {sleeping.p50_us - 7200:.0f} and {sleeping.p99_us - 7200:.0f} us late, with "
        f"--busy-poll {polling.p50_us - 7200:.0f} and {polling.p99_us - 7200:.0f} us"
    )


def start_row(bench: Bench) -> str:
    """Time from process start to its line `ready`, with compiled kernels and .pyc files."""
    rows = []
    for name, command in commands(argparse.Namespace(router=None, command=[]), bench).items():
        if name not in ("mavproxy-fault, no fault", "mavproxy-fault, ten faults"):
            continue
        times = []
        for _ in range(9):
            begun = time.perf_counter()
            text = command.format(master="127.0.0.1:0", out="127.0.0.1:9")
            process = subprocess.Popen(shlex.split(text), stdout=subprocess.PIPE)
            assert process.stdout is not None
            process.stdout.readline()
            times.append(time.perf_counter() - begun)
            process.send_signal(signal.SIGINT)
            process.communicate()
        rows.append(f"{name} {statistics.median(times):.2f} s ({min(times):.2f}-{max(times):.2f})")
    return f"start to ready, median of 9: {'; '.join(rows)}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--router", help="a mavlink-routerd to compare with")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--realtime", action="store_true", help="measure as SCHED_FIFO, on a machine that is busy"
    )
    parser.add_argument("--repeat", type=int, default=1, help="of each case within a round")
    parser.add_argument("--command", action="append", default=[], help="NAME=COMMAND")
    args = parser.parse_args()
    subprocess.run([sys.executable, "-m", "mavproxy_fault.compiled.object_file"], check=True)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), args.realtime)
        found: dict[tuple[str, str], list[Outcome]] = {}
        for _ in range(args.rounds):
            for name, command in commands(args, bench).items():
                with bench.running(command) as (process, in_port, out_port):
                    for case, mode, pace, count in CASES * args.repeat:
                        outcome = bench.measure(process, in_port, out_port, mode, pace, count)
                        found.setdefault((name, case), []).append(outcome)
        print("| proxy | case | k/s | p50 us | p99 us | lost | CPU s per million |")
        print("|---|---|---|---|---|---|---|")
        for (name, case), outcomes in found.items():
            middle = [statistics.median(column) for column in zip(*outcomes, strict=True)]
            outcome = Outcome(*middle)
            rate = statistics.median(one.rate_k for one in outcomes)
            per_million = outcome.cpu_s / max(outcome.received, 1) * 1e6
            print(
                f"| {name} | {case} | {rate:.0f} | {outcome.p50_us:.1f} | {outcome.p99_us:.1f} "
                f"| {max(one.lost for one in outcomes)} | {per_million:.1f} |"
            )
        print(f"\n{delay_row(bench)}\n\n{cold_row(bench)}\n\n{start_row(bench)}")


if __name__ == "__main__":
    main()
