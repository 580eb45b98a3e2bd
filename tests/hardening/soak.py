"""Soak test: hours of traffic with ten faults, an edit per second, and the page open.

    python -m tests.hardening.soak --minutes 240 --rate 20000 --page
    python -m tests.hardening.soak --minutes 240 --rate 20000 --speed 2.5

The minutes, the frames per second and the edit per second are those of the vehicle's clock. With
`--speed` it runs faster than the wall clock, and so does every clock of the proxy's process, by
libfaketime (Debian's `faketime`; `FAKETIME_LIBRARY` names another path): the events of hours happen
in less. The proxy's statistics, published once per second of its own clock, show its age by that
clock. Prints a row of values periodically (`--csv FILE` stores them): memory and descriptors of the
proxy, the delay of its frames, the kernel's drops (at the proxy, at the station, or in the queue of
either processor), and with `--page` the load of a browser (Debian's Chromium), of its frames at the
end of the row's time, and of the page's server. Edits are counted per row. Ctrl-C or SIGTERM end it
with a last row and the proxy's own counts; SIGSTOP pauses it: traffic continues afterwards.
"""

import argparse
import contextlib
import csv
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.api.proxy_handle import LiveFault, Proxy
from mavproxy_fault.compiled import object_file
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.links.link import enlarge_buffers
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from tests.hardening.datagrams import Inbox, send_all
from tests.hardening.page_watcher import FRAME_COLUMNS, PageWatcher, watched_page
from tests.hardening.proxy_process import CLOCK_LIBRARY

MARKED = 42  # the system whose heartbeats are timed
MARK_EVERY = 50  # frames
BURST_S = 0.005  # between two bursts of frames
LOOK_S = 0.002  # between two reads of the station
SETTLE_S = 6.0  # after the last frame: a mark is missing after five
FRAMES_S = 20.0  # of the page's frames that are analysed one by one
SO_TIMESTAMPNS = 35  # Linux <asm-generic/socket.h>
FIELDS = (
    "xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag", "abs_pressure",
)  # fmt: skip
COLUMNS = (
    "min", "vehicle min", "proxy min", "sent/s", "came/s", "edits", "unanswered", "marks missing",
    "lost before proxy", "before station", "between", "proxy, of a core",
    "proxy MB", "descriptors", "p50 ms", "p99 ms", "max ms", "server, of a core", "server MB",
    "script s/s", "heap MB", *FRAME_COLUMNS,
)  # fmt: skip


class Traffic:
    """A vehicle that sends at a rate, and the station that times its marks."""

    def __init__(self, rate_hz: int, speed: float, frames: int) -> None:
        self.vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.station.bind(("127.0.0.1", 0))
        enlarge_buffers(self.station)  # a busy machine's pause must not be taken for a loss
        # Kernel timestamps, because this process may read late.
        self.station.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.rate_hz, self.burst = rate_hz, round(rate_hz * speed * BURST_S)
        self.frames = frames  # that are sent in all
        self.sent = self.came = self._sensors = 0
        self.due_s: dict[int, float] = {}
        self.late_s: list[float] = []
        self.over = threading.Event()
        rest = {"zacc": -9.81, "abs_pressure": 1013.0, "fields_updated": 0x1FFF}
        self._sensor = bytearray(
            build_frame(
                message_layout("HIL_SENSOR"), {"time_usec": 1 << 40, **rest}, system=1, component=51
            )
        )

    @property
    def clock_s(self) -> float:
        """The vehicle's, since it began."""
        return self.sent / self.rate_hz

    @property
    def all_sent(self) -> bool:
        """Whether the vehicle's time is over."""
        return self.sent >= self.frames

    def send(self) -> None:
        """Send frames in bursts; bursts missed while this process waited are sent later."""
        next_s = time.monotonic()
        while not self.all_sent and not self.over.wait(max(next_s - time.monotonic(), 0.0)):
            next_s = max(next_s + BURST_S, time.monotonic() - BURST_S)
            numbers = range(self.sent + 1, min(self.sent + self.burst, self.frames) + 1)
            burst = [self.frame(number) for number in numbers]
            while burst:
                taken = send_all(self.vehicle, burst)
                self.sent += taken
                burst = burst[taken:]

    def frame(self, number: int) -> bytes:
        """Marks are heartbeats, the other frames are those of a simulator."""
        if number % MARK_EVERY == 0:
            self.due_s[number] = time.time()
            values = {"type": 2, "custom_mode": number}
            return build_frame(message_layout("HEARTBEAT"), values, seq=number // MARK_EVERY & 255,
            system=MARKED,
                         component=1)  # fmt: skip
        t_us = 1_000_000 + number * 1_000_000 // self.rate_hz
        if number % 40 == 1:
            values = {"time_boot_ms": t_us // 1000, "roll": 0.3 * np.sin(t_us / 1e6), "yaw": 1.0}
            return build_frame(
                message_layout("ATTITUDE"), values, seq=number // 40 & 255, system=1, component=1
            )
        # For 20,000 frames per second, write only the changing bytes.
        raw = self._sensor
        self._sensors += 1
        raw[4] = self._sensors & 255
        raw[10:18] = t_us.to_bytes(8, "little")
        extra = bytes((message_layout("HIL_SENSOR").crc_extra,))
        raw[-2:] = mcrf4xx(bytes(raw[1:-2]) + extra).to_bytes(2, "little")
        return bytes(raw)

    def receive(self) -> None:
        """Record how late each mark is."""
        inbox = Inbox(self.station)
        while not self.over.is_set():
            select.select([self.station], [], [], 0.5)
            time.sleep(LOOK_S)  # many at once
            while len(rows := inbox.receive()):
                self.came += len(rows)
                # The sender in a frame of version 2; the proxy's own have the system of another.
                for row in np.flatnonzero((rows[:, 5] == MARKED) & (rows[:, 6] == 1)):
                    number = int.from_bytes(rows[row, 10:14].tobytes(), "little")
                    self.late_s.append(inbox.came_s(row) - self.due_s.pop(number))

    def missing(self) -> int:
        """The number of marks not received after five seconds."""
        return sum(time.time() - due_s > 5.0 for due_s in list(self.due_s.values()))

    def latencies(self) -> list[str]:
        """Median, 99th percentile and maximum in ms since the last call."""
        late_ms, self.late_s = 1e3 * np.array(self.late_s or [np.nan]), []
        return [f"{late:.2f}" for late in np.percentile(late_ms, [50, 99, 100])]


def usage(pid: int) -> tuple[float, float, int]:
    """Processor seconds, resident memory in MB, and open descriptors of a process."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    cpu_s = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    memory_mb = int(words[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return cpu_s, memory_mb, len(os.listdir(f"/proc/{pid}/fd"))


def lost(*ports: int) -> list[int]:
    """The kernel's drops because of full buffers: at each UDP port, and before any."""
    before = {}
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        words = line.split()
        before[int(words[1].rpartition(":")[2], 16)] = int(words[-1])
    queues = Path("/proc/net/softnet_stat").read_text().splitlines()
    return [*(before[port] for port in ports), sum(int(one.split()[1], 16) for one in queues)]


@contextlib.contextmanager
def command(*words: str, **environment: str) -> Iterator[tuple[int, str]]:
    """Run a mavproxy-fault command as a process; yield its pid and first output line."""
    whole = [sys.executable, "-m", "mavproxy_fault.cli", *words]
    with subprocess.Popen(
        whole, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    ) as process:
        assert process.stdout is not None
        try:
            yield process.pid, process.stdout.readline()
        finally:
            process.terminate()
            print(process.stdout.read())  # a proxy ends with its counts, including losses


class Rows:
    """The table of values, printed and written to a file row by row."""

    def __init__(self, path: str | None) -> None:
        self._path = path
        if path:
            Path(path).write_text("")
        self._write(COLUMNS)
        print("|---" * len(COLUMNS) + "|", flush=True)

    def add(self, row: Sequence[object]) -> None:
        """One more row; a file that is cut off in the middle has all rows before."""
        self._write([str(one) for one in row] + [""] * (len(COLUMNS) - len(row)))

    def _write(self, row: Sequence[str]) -> None:
        print("| " + " | ".join(row) + " |", flush=True)
        if self._path:
            with open(self._path, "a", newline="") as file:
                csv.writer(file).writerow(row)


class Edits:
    """One a second of the vehicle's clock, each of the next fault."""

    def __init__(self, proxy: Proxy, traffic: Traffic) -> None:
        self._faults: list[LiveFault] = [
            proxy.fault("bias", id=name, target=f"HIL_SENSOR.{name}", value=0.1) for name in FIELDS
        ]
        self._traffic = traffic
        self.made = self.unanswered = 0

    def until(self, end_s: float) -> None:
        """Edit until a time, or until all is sent and edited."""
        while time.monotonic() < end_s:
            if self.made >= int(self._traffic.clock_s):
                if self._traffic.all_sent:
                    return
                time.sleep(0.02)
                continue
            self.made += 1
            try:
                self._faults[self.made % len(FIELDS)].update(0.1 + self.made % 7)
            except ConfigError:  # counted: a busy machine may let the bus's time run out
                self.unanswered += 1


def fast_clock(speed: float) -> dict[str, str]:
    """What lets every clock of a process run faster than the wall's."""
    if speed == 1.0:
        return {}
    if not CLOCK_LIBRARY:
        sys.exit("--speed: libfaketime is not there; FAKETIME_LIBRARY can name it")
    return {"LD_PRELOAD": CLOCK_LIBRARY, "FAKETIME": f"+0 x{speed}"}


def watch(args: argparse.Namespace, traffic: Traffic, pids: list[int], bus: Bus,
          page: PageWatcher | None, ports: tuple[int, int]) -> None:  # fmt: skip
    """Edit faults, and add a row after each `--every` minutes, also the last."""
    lived_s: list[str] = []  # an entry for each second of the proxy
    bus.subscribe("proxy/stats", lambda key, _: lived_s.append(key))
    rows = Rows(args.csv)
    begin_s = time.monotonic()
    stopped = False
    between = lost()[0]
    with Proxy.attach(bus.url) as proxy:
        edits = Edits(proxy, traffic)
        while not stopped and not traffic.all_sent:
            from_s = time.monotonic()
            cpu_s = [usage(pid)[0] for pid in pids]
            script_s = page.usage()[0] if page else 0.0
            from_sent, from_came = traffic.sent, traffic.came
            made, unanswered = edits.made, edits.unanswered
            try:
                edits.until(from_s + 60 * args.every)
            except KeyboardInterrupt:  # Ctrl-C or SIGTERM: a last row, and the proxy's own words
                stopped = True
            if traffic.all_sent:
                time.sleep(SETTLE_S)  # the last frames are on their way
            span_s = time.monotonic() - from_s
            used = [usage(pid) for pid in pids]
            share = [f"{(one[0] - before_s) / span_s:.1%}"
                     for one, before_s in zip(used, cpu_s, strict=True)]  # fmt: skip
            row = [f"{(time.monotonic() - begin_s) / 60:.1f}", f"{traffic.clock_s / 60:.1f}",
                   f"{len(lived_s) / 60:.1f}",
                   f"{(traffic.sent - from_sent) / span_s:.0f}",
                   f"{(traffic.came - from_came) / span_s:.0f}",
                   edits.made - made, edits.unanswered - unanswered,
                   traffic.missing(), *lost(*ports)[:2], lost()[0] - between,
                   share[0], f"{used[0][1]:.1f}", used[0][2],
                   *traffic.latencies()]  # fmt: skip
            if page:
                script_now_s, heap_mb = page.usage()
                row += [share[1], f"{used[1][1]:.1f}", f"{(script_now_s - script_s) / span_s:.3f}",
                        f"{heap_mb:.1f}", *page.frames(FRAMES_S).cells()]  # fmt: skip
            rows.add(row)
    print(f"{traffic.sent} frames sent, {traffic.came} came; "
          f"{edits.made} edits, {edits.unanswered} unanswered")  # fmt: skip


def main() -> None:
    """Start the processes and watch them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=240.0)
    parser.add_argument("--every", type=float, default=10.0, help="minutes between two rows")
    parser.add_argument("--rate", type=int, default=20_000, help="frames a second")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="of the vehicle's and the proxy's clocks"
    )
    parser.add_argument("--page", action="store_true", help="watch the page in a browser, too")
    parser.add_argument("--csv", help="file for the rows, besides the printed table")
    args = parser.parse_args()
    if object_file.load() is None:  # ten faults at this rate are too much without it
        object_file.make()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    traffic = Traffic(args.rate, args.speed, round(60 * args.minutes * args.rate))
    station = traffic.station.getsockname()[1]
    with contextlib.ExitStack() as stack:
        # By the proxy's name, whose samples it takes.
        bus = stack.enter_context(open_bus("tcp/127.0.0.1:0", run="live", router=True))
        links = ("--master", "udpin:127.0.0.1:0", "--to", f"udpout:127.0.0.1:{station}")
        proxy = command("proxy", *links, "--zenoh", bus.url, **fast_clock(args.speed))
        pid, ready = stack.enter_context(proxy)
        pids, page = [pid], None
        port = int(ready.split()[1].rpartition(":")[2])
        traffic.vehicle.connect(("127.0.0.1", port))
        for work in (traffic.receive, traffic.send):
            thread = threading.Thread(target=work)
            thread.start()
            stack.callback(thread.join)
            stack.callback(traffic.over.set)  # before the join
        if args.page:
            server, line = stack.enter_context(command("ui", "--port", "0", "--zenoh", bus.url))
            pids.append(server)
            address = "http://" + line.partition("http://")[2].strip()
            page = stack.enter_context(watched_page(address))
        watch(args, traffic, pids, bus, page, (port, station))


if __name__ == "__main__":
    main()
