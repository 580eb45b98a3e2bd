"""Processor time of a proxy per frame, whatever the link and the traffic.

    python benchmarks/wire_costs.py [--router PATH] [--rounds N] [--lockstep]
    python benchmarks/wire_costs.py --faults

The first form sends windows of 64 frames of HIL_SENSOR through proxies that take turns in each
round: a forwarder in C (UDP only), mavlink-router (built by the person who runs this) and
mavproxy-fault, as processes; it prints microseconds of their processor time per frame, medians of
the rounds. With `--lockstep` there is one frame at a time, and it prints the median microseconds
from its sending to its arrival. The second form gives the cost of each fault of the catalogue
within one process, in units of that of a bias.
"""

import argparse
import contextlib
import ctypes
import shlex
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.compiled.object_file import make
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import HEADER_V1, HEADER_V2, Frame, build_frame
from mavproxy_fault.wire.signing import derive_key
from tests.signed_frames import sign_frame

HERE = Path(__file__).parent
WINDOW, FRAMES, WARM = 64, 32_000, 3_200
PHRASE = "correct horse"
BIAS = "faults: [{fault: bias, target: HIL_SENSOR.xgyro, value: 0.1}]\n"
FIELDS = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag", "temperature")
TEN = "faults:\n" + "".join(
    f"  - {{fault: bias, target: HIL_SENSOR.{name}, value: 0.1}}\n" for name in FIELDS
)
KEY = object()  # stands for the option --signing-key


def sensor(n: int, system: int = 1) -> bytes:
    """A frame of HIL_SENSOR at 250 Hz."""
    values = {"time_usec": 1_000_000 + 4000 * n, "xgyro": 0.3, "zacc": -9.8, "fields_updated": 63}
    layout = message_layout("HIL_SENSOR")
    return build_frame(layout, values, seq=n & 255, system=system, component=51)


def signed(n: int) -> bytes:
    """The same, signed."""
    frame = Frame(sensor(n), message_layout("HIL_SENSOR"))
    return sign_frame(frame, derive_key(PHRASE), 0, 10**12 + 400 * n).raw


def mixed(n: int) -> bytes:
    """Frames of both versions, and signed ones, in turns."""
    if n % 3 == 0:
        return signed(n)
    if n % 3 == 1:
        return sensor(n)
    layout = message_layout("ATTITUDE")
    raw = build_frame(layout, {"time_boot_ms": 1000 + 4 * n, "yawspeed": 1.0}, seq=n & 255)
    payload = raw[HEADER_V2:-2].ljust(layout.base_length, b"\0")
    head = bytes((0xFE, len(payload), raw[4], 1, 1, layout.id))
    return Frame(head + payload + b"\0\0", layout).with_payload(payload).raw[: HEADER_V1 + 30]


def two_messages(n: int) -> bytes:
    """A datagram of two messages."""
    layout = message_layout("ATTITUDE")
    values = {"time_boot_ms": 1000 + 4 * n, "yawspeed": 1.0}
    return sensor(n) + build_frame(layout, values, seq=n & 255)


# Row: transport, datagram, schedule, options
ROWS: dict[str, tuple[str, Callable[[int], bytes], str, tuple[object, ...]]] = {
    "UDP": ("udp", sensor, "", ()),
    "UDP, ten faults": ("udp", sensor, TEN, ()),
    "signed, no key": ("udp", signed, "", ()),
    "signed, key": ("udp", signed, "", (KEY,)),
    "signed, key and a bias": ("udp", signed, BIAS, (KEY,)),
    "mixed v1, v2, signed": ("udp", mixed, "", ()),
    "IPv6": ("udp6", sensor, "", ()),
    "two messages in a datagram": ("udp", two_messages, "", ()),
    "TCP": ("tcp", sensor, "", ()),
    "TCP, a fault": ("tcp", sensor, BIAS, ()),
    "TCP, ten faults": ("tcp", sensor, TEN, ()),
}


class Ends:
    """The vehicle's and the station's socket of one transport."""

    def __init__(self, transport: str) -> None:
        self.host = "::1" if transport == "udp6" else "127.0.0.1"
        self.tcp = transport == "tcp"
        family = socket.AF_INET6 if transport == "udp6" else socket.AF_INET
        kind = socket.SOCK_STREAM if self.tcp else socket.SOCK_DGRAM
        self.vehicle, self.station = socket.socket(family, kind), socket.socket(family, kind)
        with socket.socket(family, kind) as place:
            place.bind((self.host, 0))
            self.port = place.getsockname()[1]
        self.station.bind((self.host, 0))
        if self.tcp:
            self.station.listen()
        for one in (self.vehicle, self.station):
            one.settimeout(2)
        self.out = self.station.getsockname()[1]

    @property
    def address(self) -> str:
        """The host as connection strings have it."""
        return "[::1]" if ":" in self.host else self.host

    def connect(self) -> None:
        """Connect both ends to the running proxy."""
        for _ in range(100):
            with contextlib.suppress(ConnectionError):
                self.vehicle.connect((self.host, self.port))
                for _ in range(0 if self.tcp else 2):  # refused until a proxy has the port
                    self.vehicle.send(b"")
                    time.sleep(0.1)
                break
            time.sleep(0.1)
        if self.tcp:
            self.station, listener = self.station.accept()[0], self.station
            listener.close()
            self.station.settimeout(2)
            for one in (self.vehicle, self.station):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def exchange(self, datagrams: list[bytes]) -> int:
        """Send datagrams and return how many bytes arrived."""
        expected, came = sum(map(len, datagrams)), 0
        for datagram in datagrams:
            self.vehicle.send(datagram)
        with contextlib.suppress(TimeoutError):
            while came < expected:
                came += len(self.station.recv(65_536))
        return came

    def close(self) -> None:
        self.vehicle.close()
        self.station.close()


def commands(row: str, args: argparse.Namespace, folder: Path) -> dict[str, str]:
    """The proxies that can serve a row."""
    transport, _, schedule, options = ROWS[row]
    found = {}
    if transport == "udp" and not schedule and KEY not in options:
        found["C"] = f"{folder / 'forwarder'} {{port}} {{out}}"
    if args.router and transport != "tcp":
        found["mavlink-router"] = f"{args.router} -t 0 -e {{host}}:{{out}} {{host}}:{{port}}"
    if args.router and transport == "tcp":
        found["mavlink-router"] = f"{args.router} -t {{port}} -p {{host}}:{{out}}"
    master, to = ("tcpin", "tcp") if transport == "tcp" else ("udpin", "udpout")
    ours = f"{sys.executable} -m mavproxy_fault.cli proxy --zenoh off "
    ours += f"--master {master}:{{host}}:{{port}} --to {to}:{{host}}:{{out}}"
    if schedule:
        (folder / "schedule.yaml").write_text(schedule)
        ours += f" --schedule {folder / 'schedule.yaml'}"
    if KEY in options:
        (folder / "phrase").write_text(PHRASE)
        ours += f" --signing-key {folder / 'phrase'}"
    return {**found, "mavproxy-fault": ours}


@contextlib.contextmanager
def running(command: str, ends: Ends) -> Iterator[subprocess.Popen[bytes]]:
    """A proxy with both ends connected."""
    text = command.format(host=ends.address, port=ends.port, out=ends.out)
    process = subprocess.Popen(shlex.split(text), stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)  # fmt: skip
    try:
        time.sleep(1.5)
        ends.connect()
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def cpu_s(process: subprocess.Popen[bytes]) -> float:
    """Processor time of all threads, to the nanosecond; clock ticks of 10 ms would be 0.3 us."""
    clock = ctypes.c_int()
    ctypes.CDLL(None).clock_getcpuclockid(process.pid, ctypes.byref(clock))
    return time.clock_gettime(clock.value)


@contextlib.contextmanager
def warm(row: str, command: str) -> Iterator[tuple[Ends, subprocess.Popen[bytes], list[bytes]]]:
    """A proxy that has passed some frames, and the frames for the measurement."""
    transport, datagram, _, _ = ROWS[row]
    ends = Ends(transport)
    frames = [datagram(n) for n in range(WARM + FRAMES)]
    try:
        with running(command, ends) as process:
            for first in range(0, WARM, WINDOW):
                ends.exchange(frames[first : first + WINDOW])
            time.sleep(1.0)  # live control is loaded in the first second
            yield ends, process, frames[WARM:]
    finally:
        ends.close()


def cost_us(row: str, command: str) -> float:
    """Microseconds of processor time per frame; NaN if frames were lost."""
    with warm(row, command) as (ends, process, frames):
        before_s, came = cpu_s(process), 0
        for first in range(0, FRAMES, WINDOW):
            came += ends.exchange(frames[first : first + WINDOW])
        spent_s = cpu_s(process) - before_s
        whole = came >= 0.999 * sum(map(len, frames))
        return spent_s / FRAMES * 1e6 if whole else float("nan")


def round_trip_us(row: str, command: str) -> float:
    """Median microseconds from sending a frame until it has arrived, one at a time."""
    with warm(row, command) as (ends, _, frames):
        times_ns = []
        for frame in frames:
            begun_ns = time.perf_counter_ns()
            ends.exchange([frame])
            times_ns.append(time.perf_counter_ns() - begun_ns)
        return statistics.median(times_ns) / 1000


def print_links(args: argparse.Namespace) -> None:
    """Measure all rows and print them."""
    make()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run(["cc", "-O2", "-o", folder / "forwarder", HERE / "forwarder.c"], check=True)
        print("| row | C | mavlink-router | mavproxy-fault | of mavlink-router |")
        print("|---|---|---|---|---|")
        for row in ROWS:
            costs: dict[str, list[float]] = {}
            for _ in range(args.rounds):
                for proxy, command in commands(row, args, folder).items():
                    measure = round_trip_us if args.lockstep else cost_us
                    costs.setdefault(proxy, []).append(measure(row, command))
            medians = {proxy: statistics.median(found) for proxy, found in costs.items()}
            words = [
                f"{medians[proxy]:.1f}" if proxy in medians else ""
                for proxy in ("C", "mavlink-router", "mavproxy-fault")
            ]
            peer = medians.get("mavlink-router")
            ratio = f"{medians['mavproxy-fault'] / peer:.2f}" if peer else ""
            print("| " + " | ".join([row, *words, ratio]) + " |", flush=True)


def fault_us(faults: list[dict[str, Any]], chunks: list[bytes]) -> float:
    """Microseconds per frame of a schedule, the better of two runs."""
    best_s = float("inf")
    for _ in range(2):
        engine = Engine(parse_schedule({"seed": 1, "faults": faults}))
        links = [LinkRole("a", "from-vehicle", False), LinkRole("b", "to-vehicle", False)]
        core = Core(links, engine)
        compiled, now_us = CompiledCore(core, 0, None), 10**12
        begun_s = time.process_time()
        for chunk in chunks:
            now_us += 4000 * WINDOW
            compiled.received(0, chunk, now_us)
            core.due(now_us + 2000 * WINDOW)
        best_s = min(best_s, time.process_time() - begun_s)
    return best_s / (WINDOW * len(chunks)) * 1e6


def print_faults() -> None:
    """Measure the whole catalogue and print it."""
    make()
    chunks = [b"".join(map(sensor, range(n, n + WINDOW))) for n in range(0, 12_800, WINDOW)]
    bias = fault_us([{"fault": "bias", **known_faults()["bias"].example}], chunks)
    print(f"bias: {bias:.2f} us a frame\n\n| fault | of a bias |\n|---|---|")
    for name, kind in known_faults().items():
        print(f"| {name} | {fault_us([{'fault': name, **kind.example}], chunks) / bias:.1f} |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--router", help="path of mavlink-routerd")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--lockstep", action="store_true", help="one frame at a time: latency")
    parser.add_argument("--faults", action="store_true", help="measure the faults instead")
    args = parser.parse_args()
    if args.faults:
        print_faults()
    else:
        print_links(args)


if __name__ == "__main__":
    main()
