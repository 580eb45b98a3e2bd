"""Hours of traffic with ten faults and an edit a second, and the page that watches it.

    python tests/hardening/soak.py --minutes 240 --rate 20000 --page

Prints a row of figures now and then: what the proxy holds, how late its frames are, and with
`--page` what a browser (Debian's Chromium) and the page's server take. SIGSTOP pauses it: traffic
goes on where it was.
"""

import argparse
import contextlib
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mavproxy_fault.api.proxy_handle import Proxy
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import build

MARKED = 42  # the system whose heartbeats are timed
MARK_EVERY = 50  # frames
TURN_S = 0.01  # between two bursts of frames
FIELDS = (
    "xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag", "abs_pressure",
)  # fmt: skip
COLUMNS = (
    "min", "frames/s", "edits", "unanswered", "marks missing", "proxy, of a core", "proxy MB",
    "descriptors", "p50 ms", "p99 ms", "max ms", "server, of a core", "server MB", "script s/s",
    "heap MB",
)  # fmt: skip


class Traffic:
    """A vehicle that sends at a rate, and the station that times its marks."""

    def __init__(self, rate_hz: int) -> None:
        self.vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.station.bind(("127.0.0.1", 0))
        self.station.settimeout(0.5)
        self.rate_hz = rate_hz
        self.sent = 0
        self.due_s: dict[int, float] = {}
        self.late_s: list[float] = []
        self.over = threading.Event()

    def send(self) -> None:
        """Frames in bursts, each stamped with the time it would have at its rate."""
        while not self.over.wait(TURN_S):
            for _ in range(round(self.rate_hz * TURN_S)):
                self.sent += 1
                self.vehicle.send(self.frame(self.sent))

    def frame(self, number: int) -> bytes:
        """The marks are heartbeats, the rest what a simulator sends."""
        if number % MARK_EVERY == 0:
            self.due_s[number] = time.monotonic()
            values = {"type": 2, "custom_mode": number}
            return build(known("HEARTBEAT"), values, seq=number // MARK_EVERY & 255, system=MARKED,
                         component=1)  # fmt: skip
        t_us = 1_000_000 + number * 1_000_000 // self.rate_hz
        if number % 40 == 1:
            turn = {"time_boot_ms": t_us // 1000, "roll": 0.3 * np.sin(t_us / 1e6), "yaw": 1.0}
            return build(known("ATTITUDE"), turn, seq=number & 255, system=1, component=1)
        values = {
            "time_usec": t_us,
            "zacc": -9.81,
            "abs_pressure": 1013.0,
            "fields_updated": 0x1FFF,
        }
        return build(known("HIL_SENSOR"), values, seq=number & 255, system=1, component=51)

    def receive(self) -> None:
        """Note how late each mark is."""
        while not self.over.is_set():
            with contextlib.suppress(TimeoutError):
                data = self.station.recv(2048)
                if data[5] == MARKED:  # the sender's system in a frame of version 2
                    number = int.from_bytes(data[10:14], "little")
                    self.late_s.append(time.monotonic() - self.due_s.pop(number))

    def missing(self) -> int:
        """The marks that have not come after five seconds."""
        return sum(time.monotonic() - due_s > 5.0 for due_s in list(self.due_s.values()))

    def latencies(self) -> list[str]:
        """Median, 99th percentile and maximum in ms since they were asked for last."""
        late_ms, self.late_s = 1e3 * np.array(self.late_s), []
        return [f"{late:.2f}" for late in np.percentile(late_ms, [50, 99, 100])]


def usage(pid: int) -> tuple[float, float, int]:
    """Processor seconds, resident memory in MB, and open descriptors of a process."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    cpu_s = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    memory_mb = int(words[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return cpu_s, memory_mb, len(os.listdir(f"/proc/{pid}/fd"))


@contextlib.contextmanager
def command(*words: str) -> Iterator[tuple[int, str]]:
    """A command of ours in its own process: its number and its first line."""
    whole = [sys.executable, "-m", "mavproxy_fault.cli", *words]
    with subprocess.Popen(whole, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.pid, process.stdout.readline()
        finally:
            process.terminate()


@contextlib.contextmanager
def watcher(address: str) -> Iterator[Any]:
    """A browser that shows the page; a session of its debugging protocol."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--disable-gpu", "--enable-precise-memory-info"]
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=arguments
        )
        page = browser.new_page()
        page.goto(address)
        page.wait_for_selector("#connection.there")
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable")
        yield session
        browser.close()


def browser_usage(session: Any) -> tuple[float, float]:
    """Seconds of script so far, and the heap in MB after its garbage was collected."""
    session.send("HeapProfiler.collectGarbage")
    found = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
    return found["ScriptDuration"], found["JSHeapUsedSize"] / 1e6


def watch(args: argparse.Namespace, traffic: Traffic, pids: list[int], router: str,
          session: Any) -> None:  # fmt: skip
    """Edit a fault every second, and print a row after each `--every` minutes."""
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    edits = unanswered = 0
    begin_s = time.monotonic()
    with Proxy.attach(router) as proxy:
        faults = [
            proxy.fault("bias", id=name, target=f"HIL_SENSOR.{name}", value=0.1) for name in FIELDS
        ]
        while time.monotonic() - begin_s < 60 * args.minutes:
            cpu_s = [usage(pid)[0] for pid in pids]
            script_s = browser_usage(session)[0] if session else 0.0
            from_s, from_sent = time.monotonic(), traffic.sent
            while (span_s := time.monotonic() - from_s) < 60 * args.every:
                edits += 1
                try:
                    faults[edits % len(faults)].update(0.1 + edits % 7)
                except ConfigError:  # counted: a busy machine may let the bus's time run out
                    unanswered += 1
                time.sleep(1.0)
            used = [usage(pid) for pid in pids]
            share = [f"{(one[0] - before_s) / span_s:.1%}"
                     for one, before_s in zip(used, cpu_s, strict=True)]  # fmt: skip
            row = [f"{(time.monotonic() - begin_s) / 60:.1f}",
                   f"{(traffic.sent - from_sent) / span_s:.0f}", edits, unanswered,
                   traffic.missing(), share[0], f"{used[0][1]:.1f}", used[0][2],
                   *traffic.latencies()]  # fmt: skip
            if session:
                script_now_s, heap_mb = browser_usage(session)
                row += [share[1], f"{used[1][1]:.1f}", f"{(script_now_s - script_s) / span_s:.3f}",
                        f"{heap_mb:.1f}"]  # fmt: skip
            print("| " + " | ".join(map(str, row)) + " |", flush=True)


def main() -> None:
    """Start the processes and watch them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=240.0)
    parser.add_argument("--every", type=float, default=10.0, help="minutes between two rows")
    parser.add_argument("--rate", type=int, default=20_000, help="frames a second")
    parser.add_argument("--page", action="store_true", help="watch the page in a browser, too")
    args = parser.parse_args()
    traffic = Traffic(args.rate)
    station = traffic.station.getsockname()[1]
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(open_bus("tcp/127.0.0.1:0", run="soak", router=True)).url
        links = ("--master", "udpin:127.0.0.1:0", "--out", f"udpout:127.0.0.1:{station}")
        pid, ready = stack.enter_context(command("proxy", *links, "--zenoh", router))
        pids, session = [pid], None
        traffic.vehicle.connect(("127.0.0.1", int(ready.split()[1].rpartition(":")[2])))
        for work in (traffic.receive, traffic.send):
            thread = threading.Thread(target=work)
            thread.start()
            stack.callback(thread.join)
            stack.callback(traffic.over.set)  # before the join
        if args.page:
            server, line = stack.enter_context(command("ui", "--port", "0", "--zenoh", router))
            pids.append(server)
            session = stack.enter_context(watcher("http://" + line.partition("http://")[2].strip()))
        watch(args, traffic, pids, router, session)


if __name__ == "__main__":
    main()
