"""The page's server under load: 8 signals at 50 Hz to 1 and to 20 viewers, and one that is frozen.

    python benchmarks/page.py

Prints what each viewer saw and the share of a core that the server's process took.
"""

import asyncio
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import websockets

from mavproxy_fault.links.bus import Bus, open_bus

SECONDS = 8.0
RATE_HZ = 50
SIGNALS = ("fdi/main/stat", *(f"att/estimator-{n}/score" for n in range(7)))


def cpu_s(pid: int) -> float:
    """Processor seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def publish(bus: Bus) -> int:
    """Eight samples, 50 times a second; how often."""
    begin_s = time.monotonic()
    number = 0
    while number < SECONDS * RATE_HZ:
        for key in SIGNALS:
            bus.put(key, json.dumps({"t_s": number / RATE_HZ, "angle": 1.0}).encode())
        number += 1
        await asyncio.sleep(max(0.0, begin_s + number / RATE_HZ - time.monotonic()))
    return number


async def view(address: str, over: asyncio.Event) -> int:
    """The number of samples of one signal that a viewer sees."""
    seen = 0
    async with websockets.connect(address) as socket:
        while not over.is_set():
            try:
                message = await asyncio.wait_for(socket.recv(), 0.5)
            except TimeoutError:
                continue
            samples = json.loads(message)
            if samples[0][0] != "page/picture":  # the past, told once at the start
                seen += sum(key == SIGNALS[0] for key, _ in samples)
    return seen


async def freeze(address: str, over: asyncio.Event) -> None:
    """A viewer that never reads."""
    async with websockets.connect(address, max_queue=1):
        await over.wait()


async def measure(bus: Bus, pid: int, address: str, viewers: int) -> str:
    """One row of the table."""
    over = asyncio.Event()
    views = [asyncio.create_task(view(address, over)) for _ in range(viewers)]
    frozen = asyncio.create_task(freeze(address, over))
    await asyncio.sleep(1.5)
    before_s, begin_s = cpu_s(pid), time.monotonic()
    sent = await publish(bus)
    share = (cpu_s(pid) - before_s) / (time.monotonic() - begin_s)
    await asyncio.sleep(0.5)
    over.set()
    seen = await asyncio.gather(*views)
    await frozen
    return f"| {viewers} + 1 frozen | {sent} | {min(seen)} to {max(seen)} | {share:.1%} |"


def main() -> None:
    """Measure and print."""
    with open_bus("tcp/127.0.0.1:0", run="bench", router=True) as bus:
        bus.alive("proxy")
        command = [sys.executable, "-m", "mavproxy_fault.cli", "ui", "--port", "0"]
        server = subprocess.Popen([*command, "--zenoh", bus.url], stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        host = server.stdout.readline().partition("http://")[2].partition("/#")[0]
        address = f"ws://{host}/api/live"
        print("| viewers | updates sent | seen by each | server, of a core |\n|---|---|---|---|")
        try:
            for viewers in (1, 20):
                print(asyncio.run(measure(bus, server.pid, address, viewers)), flush=True)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
