"""The page's server under load: 8 signals at 50 Hz to 1 and to 20 viewers, and one that is frozen.

    python benchmarks/page.py

Prints what each viewer saw, the share of a core that the server's process took, and how long a
publication blocked the publisher while one viewer was frozen. The signals come once as a proxy
sends them, 8 values of a message as received and as sent in one batch, and once as 8 streams.
"""

import asyncio
import json
import os
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

import msgspec
import websockets

from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.live.subscriptions import Watched

SECONDS = 8.0
RATE_HZ = 50
STREAMS = ("fdi/main/stat", *(f"att/estimator-{n}/score" for n in range(7)))
FIELDS = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag")
Put = Callable[[Bus, int], None]


def put_batch(bus: Bus, number: int) -> None:
    """Eight values as a proxy publishes them."""
    row = (number * 20_000, *(0.1 * number + n / 3 for n in range(8)))
    samples = Watched(
        message="HIL_SENSOR", system=1, component=51, instance=0, fields=FIELDS,
        received=[row], sent=[(row[0], *(value + 0.5 for value in row[1:]))],
    )  # fmt: skip
    bus.put("proxy/watched", msgspec.json.encode([samples]))


def put_streams(bus: Bus, number: int) -> None:
    """A sample on each of eight keys."""
    for key in STREAMS:
        bus.put(key, json.dumps({"t_s": number / RATE_HZ, "angle": 1.0}).encode())


def cpu_s(pid: int) -> float:
    """Processor seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def publish(bus: Bus, put: Put) -> float:
    """Put 50 times a second; the longest that one took, in seconds."""
    begin_s = time.monotonic()
    longest_s = 0.0
    for number in range(round(SECONDS * RATE_HZ)):
        before_s = time.monotonic()
        put(bus, number)
        longest_s = max(longest_s, time.monotonic() - before_s)
        await asyncio.sleep(max(0.0, begin_s + (number + 1) / RATE_HZ - time.monotonic()))
    return longest_s


async def view(address: str, over: asyncio.Event) -> int:
    """The number of updates that a viewer sees."""
    seen = 0
    async with websockets.connect(address) as socket:
        while not over.is_set():
            try:
                message = await asyncio.wait_for(socket.recv(), 0.5)
            except TimeoutError:
                continue
            samples = json.loads(message)
            if samples[0][0] != "page/picture":  # the snapshot, sent once at the start
                seen += sum(key in (STREAMS[0], "proxy/watched") for key, _ in samples)
    return seen


async def freeze(address: str, over: asyncio.Event) -> None:
    """A viewer that never reads."""
    async with websockets.connect(address, max_queue=1):
        await over.wait()


async def measure(bus: Bus, pid: int, address: str, put: Put, viewers: int) -> str:
    """One row of the table."""
    over = asyncio.Event()
    views = [asyncio.create_task(view(address, over)) for _ in range(viewers)]
    frozen = asyncio.create_task(freeze(address, over))
    await asyncio.sleep(1.5)
    before_s, begin_s = cpu_s(pid), time.monotonic()
    longest_s = await publish(bus, put)
    share = (cpu_s(pid) - before_s) / (time.monotonic() - begin_s)
    await asyncio.sleep(0.5)
    over.set()
    seen = await asyncio.gather(*views)
    await frozen
    sent = round(SECONDS * RATE_HZ)
    kind = "one batch" if put is put_batch else "8 streams"
    found = f"| {min(seen)} to {max(seen)} | {share:.1%} | {longest_s * 1e3:.1f} ms |"
    return f"| {kind} | {viewers} + 1 frozen | {sent} {found}"


def main() -> None:
    """Measure and print."""
    with open_bus("tcp/127.0.0.1:0", run="bench", router=True) as bus:
        bus.declare_alive("proxy")
        begin_s = time.monotonic()
        command = [sys.executable, "-m", "mavproxy_fault.cli", "ui", "--port", "0"]
        server = subprocess.Popen([*command, "--zenoh", bus.url], stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        host = server.stdout.readline().partition("http://")[2].partition("/#")[0]
        printed_s = time.monotonic() - begin_s
        with urllib.request.urlopen(f"http://{host}/") as reply:
            reply.read()
        answered_s = time.monotonic() - begin_s
        print(f"To the printed address {printed_s:.2f} s, to the page {answered_s:.2f} s\n")
        address = f"ws://{host}/api/live"
        print("| signals | viewers | updates | seen by each | server, of a core | longest put |")
        print("|---|---|---|---|---|---|")
        try:
            for put in (put_batch, put_streams):
                for viewers in (1, 20):
                    row = measure(bus, server.pid, address, put, viewers)
                    print(asyncio.run(row), flush=True)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
