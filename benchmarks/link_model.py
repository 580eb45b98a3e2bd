"""The faults of a link against the kernel's tbf, and against netem's documented models in numpy.

    python benchmarks/link_model.py [--seconds 10]

Ten traces of traffic are sent through a token bucket of the kernel (`tc tbf` in a network namespace
of its own, by `unshare`) and through `rate-limit` with the same rate, burst, queue and overhead,
with timestamps at 0, 0.1, 1 and 50 Hz, without and with a peak rate. Both get each frame at the
same time: that of its system call. Before that, loss, delay, rate and slots are compared with
netem's models (tc-netem(8)) in numpy. Printed are throughput and mean delay, and by how much they
differ.
"""

import argparse
import json
import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.tlog import read_records

ROOT = Path(__file__).resolve().parents[1]
ROLES = (LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle"))
STAMP_HZ = (0.0, 0.1, 1.0, 50.0)
RATE, BURST, QUEUE = 7200, 600, 4000  # bytes: 57600 bit/s
PEAK, PEAK_BURST = 14_400, 350  # the second bucket takes the largest frame
CELL, CELL_OVERHEAD, LEAST = 48, 5, 64
OVERHEAD = 42  # bytes of Ethernet, IPv4 and UDP, which tbf counts
FTP_ID = b"\x6e\0\0"  # FILE_TRANSFER_PROTOCOL's in a header
WALL_US = 1_700_000_000_000_000
SHORT_MS = 5.0  # delays below are compared with it, not with themselves
LEAD_S = 0.5  # until all receivers listen
SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>
Trace = list[tuple[float, int]]  # seconds, bytes


def make_traces(seconds: float) -> dict[str, Trace]:
    """Return ten traces: generated traffic of several kinds and loads, and a recording."""
    rng = np.random.default_rng(1)

    def regular(rate_hz: float, size: int) -> Trace:
        return [(n / rate_hz, size) for n in range(int(seconds * rate_hz))]

    def at_random(rate_hz: float, sizes: tuple[int, int]) -> Trace:
        times = np.cumsum(rng.exponential(1 / rate_hz, int(seconds * rate_hz)))
        return [(float(t_s), int(rng.integers(*sizes))) for t_s in times]

    def bursts(every_s: float, count: int, size: int) -> Trace:
        starts = np.arange(0, seconds, every_s)
        return [(float(start) + n * 1e-4, size) for start in starts for n in range(count)]

    heavy = np.cumsum(rng.pareto(1.5, int(seconds * 60)) / 120)
    recorded = list(read_records(ROOT / "tests/data/jmavsim/hil.tlog"))
    first_us = recorded[0][0]
    return {
        "slow telemetry": regular(20, 60),
        "at the rate": regular(72, 58),
        "twice the rate": regular(150, 58),
        "log download": regular(90, 120),
        "at random, small": at_random(100, (20, 60)),
        "at random, all sizes": at_random(40, (20, 260)),
        "parameters": bursts(1.0, 60, 37),
        "mission and telemetry": sorted(regular(40, 52) + bursts(2.5, 40, 50)),
        "heavy-tailed pauses": [(float(t_s), 90) for t_s in heavy if t_s < seconds],
        "recorded HIL, thinned": [
            ((t_us - first_us) * 1e-6, min(max(len(raw), 20), 260))
            for t_us, raw, _ in recorded[::6]
            if t_us - first_us < seconds * 1e6
        ],
    }  # fmt: skip


def make_frames(trace: Trace, stamp_hz: float, seconds: float) -> list[tuple[float, bytes]]:
    """Return times and frames: numbered ones without timestamps, between others with one."""
    layout = message_layout("FILE_TRANSFER_PROTOCOL")
    timed = [(t_s, size) for t_s, size in trace]
    timed += [(n / stamp_hz, 0) for n in range(int(seconds * stamp_hz) + 1)] if stamp_hz else []
    frames = []
    for number, (t_s, size) in enumerate(sorted(timed)):
        if size:
            content = struct.pack("<I", number) + b"\xff" * (size - 15 - 4)
            raw = build_frame(layout, {"payload": list(content)}, seq=number & 255)
        else:
            raw = make_stamp(t_s)
        frames.append((t_s, raw))
    return frames


def make_stamp(t_s: float) -> bytes:
    """Return a frame with a timestamp, of the same length at any time."""
    values = {"time_boot_ms": 1_000_000 + round(t_s * 1000)}
    return build_frame(message_layout("SYSTEM_TIME"), values)


def pass_model(frames: Iterable[tuple[float, bytes]], faults: list[dict[str, Any]]) -> list[Any]:
    """Return arrival and due time of each frame that passes the faults, in order of its due time.

    All in seconds, with the bytes.
    """
    core = Core(ROLES, Engine(parse_schedule({"seed": 1, "faults": faults})))
    sends, arrivals = [], {}
    for number, (t_s, raw) in enumerate(frames):
        arrivals[raw] = t_s
        now_us = WALL_US + round(t_s * 1e6)
        sends += core.received(0, raw, now_us)
        if number % 64 == 0:
            sends += core.due(now_us)
    sends += core.due(WALL_US + 10**12)
    return [
        (arrivals[send.data], (send.due_us - WALL_US) * 1e-6, len(send.data))
        for send in sends
        if send.data in arrivals
    ]


def pass_kernel(frames: list[tuple[float, bytes]], peak: bool) -> dict[str, Any]:
    """Send frames through the loopback's tbf; run in a namespace of its own. Times in seconds."""
    limit = f"tbf rate {RATE * 8}bit burst {BURST} limit {QUEUE}".split()
    limit += f"peakrate {PEAK * 8}bit mtu {PEAK_BURST}".split() if peak else []
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    subprocess.run(["tc", "qdisc", "add", "dev", "lo", "root", *limit], check=True)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        begin, sent = time.time() + LEAD_S, []
        for t_s, raw in frames:
            time.sleep(max(begin + t_s - time.time(), 0.0))
            before_s = time.time()
            sender.send(raw)
            sent.append((before_s + time.time()) / 2 - begin)
        time.sleep(QUEUE / RATE + 0.5)
        receiver.setblocking(False)
        arrived = []
        while True:
            try:
                data, extra, *_ = receiver.recvmsg(2048, 64)
            except BlockingIOError:
                break
            whole_s, part_ns = struct.unpack("qq", extra[0][2])
            arrived.append((whole_s + part_ns * 1e-9 - begin, data.hex()))
    return {"sent": sent, "arrived": arrived}


def compare_with_tbf(seconds: float, *, peak: bool) -> float:
    """Print throughput and delay of both for all traces; return the largest difference."""
    limit = {
        "fault": "rate-limit", "value": RATE, "unit": "bytes", "overhead_bytes": OVERHEAD,
        "burst_bytes": BURST, "queue_bytes": QUEUE,
    }  # fmt: skip
    limit |= {"peak": PEAK, "peak_burst_bytes": PEAK_BURST} if peak else {}
    worst = 0.0
    print(f"{'trace':24}{'stamps':>8}{'sent':>7}{'tbf':>7}{'ours':>7}{'tbf':>10}{'ours':>10}")
    for hertz in STAMP_HZ:
        runs = {}
        for name, trace in make_traces(seconds).items():
            frames = make_frames(trace, hertz, seconds)
            command = ["unshare", "-rn", sys.executable, __file__, "--kernel", str(int(peak))]
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            runs[name] = frames, process
        for _, (frames, process) in runs.items():
            assert process.stdin is not None
            process.stdin.write(json.dumps([(t_s, raw.hex()) for t_s, raw in frames]))
            process.stdin.close()
        for name, (frames, process) in runs.items():
            assert process.stdout is not None
            result = json.loads(process.stdout.read())
            process.wait()
            sent = dict(zip((raw.hex() for _, raw in frames), result["sent"], strict=True))
            delays = [t_s - sent[raw] for t_s, raw in result["arrived"]]
            arrivals = [  # a vehicle stamps a frame when it sends it
                (sent[raw.hex()], raw if raw[7:10] == FTP_ID else make_stamp(sent[raw.hex()]))
                for _, raw in frames
            ]
            ours = pass_model(arrivals, [limit])
            kernel = sum(len(raw) // 2 for _, raw in result["arrived"]), np.mean(delays) * 1e3
            model = sum(size for *_, size in ours), np.mean([b - a for a, b, _ in ours]) * 1e3
            print(
                f"{name:24}{hertz:6.1f}Hz{len(frames):7d}{len(delays):7d}{len(ours):7d}"
                f"{kernel[1]:8.1f}ms{model[1]:8.1f}ms"
            )
            delay = abs(model[1] - kernel[1]) / max(kernel[1], SHORT_MS)
            worst = max(worst, abs(model[0] / kernel[0] - 1), delay)
    return worst


def chain_of(count: int, rng: np.random.Generator) -> np.ndarray:
    """Whether each frame is lost by `loss gemodel 2% 20% 80% 1%` of netem."""
    bad, lost = False, np.zeros(count, bool)
    for n, (u, v) in enumerate(rng.random((count, 2))):
        bad = u >= 0.2 if bad else u < 0.02
        lost[n] = v < (0.8 if bad else 0.01)
    return lost


def states_of(count: int, rng: np.random.Generator) -> np.ndarray:
    """Whether each frame is lost by `loss state 3% 10% 20% 40% 1%` of netem."""
    chain = np.array([[0.96, 0, 0.03, 0.01], [0, 0.6, 0.4, 0], [0.1, 0.2, 0.7, 0], [1.0, 0, 0, 0]])
    steps, states, state = chain.cumsum(axis=1), np.zeros(count, int), 0
    for n, u in enumerate(rng.random(count)):
        state = states[n] = int(np.searchsorted(steps[state], u, side="right"))
    return states >= 2


def reorder_of(count: int, rng: np.random.Generator) -> np.ndarray:
    """The delays of netem's `delay 100ms reorder 50% gap 4`."""
    late, passed = np.full(count, 0.1), 0
    for n, u in enumerate(rng.random(count)):
        passed += 1
        if passed >= 4 and u < 0.5:
            late[n], passed = 0.0, 0
    return late


def rate_of(
    times: np.ndarray, sizes: np.ndarray, overhead: int = OVERHEAD, cell: int = 0, least: int = 0
) -> np.ndarray:
    """The delays of netem's `rate` with an overhead and cells, or tbf's `mpu`."""
    free_s, late = 0.0, np.zeros(len(times))
    for n, (t_s, size) in enumerate(zip(times, sizes, strict=True)):
        length = max(size + overhead, least)
        length = -(-length // cell) * (cell + CELL_OVERHEAD) if cell else length
        free_s = max(free_s, t_s) + length / RATE
        late[n] = free_s - t_s
    return late


def slots_of(
    times: np.ndarray, sizes: np.ndarray, draw: Callable[[], float], octets: float = math.inf
) -> np.ndarray:
    """The delays of netem's `slot`, by its dequeue routine."""
    slot_s, room, late = 0.0, octets, np.zeros(len(times))
    for n, (t_s, size) in enumerate(zip(times, sizes, strict=True)):
        if slot_s < t_s:
            slot_s, room = t_s + draw(), octets
        late[n], room = slot_s - t_s, room - size
        if room <= 0:
            slot_s, room = slot_s + draw(), octets
    return late


def pareto_normal(count: int, rng: np.random.Generator) -> np.ndarray:
    """netem's table: a quarter of a normal quantile, three of (4/3) (Pareto of shape 3 - 1.5)."""
    normal = rng.normal(size=count)
    tail = np.array([0.5 * math.erfc(z / math.sqrt(2)) for z in normal])
    return 0.25 * normal + 0.75 * 4 / 3 * (tail ** (-1 / 3) - 1.5)


def queue_of(times: np.ndarray, sizes: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Which frames are lost by a `rate` with a queue of `most` packets, and the others' delays."""
    leaving: list[float] = []
    lost, late = np.zeros(len(times), bool), np.zeros(len(times))
    for n, (t_s, size) in enumerate(zip(times, sizes, strict=True)):
        leaving = [one for one in leaving if one > t_s]
        lost[n] = len(leaving) >= most
        if not lost[n]:
            leaving.append(max([t_s, *leaving[-1:]]) + (size + OVERHEAD) / RATE)
            late[n] = leaving[-1] - t_s
    return lost, late


def compare_with_netem(seconds: float) -> float:
    """Print throughput and mean delay of netem's models and ours; return the largest difference."""
    rng = np.random.default_rng(3)
    worst = 0.0
    jitter = {"fault": "jitter", "keep_order": False}
    rate = {"fault": "rate-limit", "value": RATE, "unit": "bytes", "overhead_bytes": OVERHEAD}
    states = {"p13": 0.03, "p31": 0.1, "p32": 0.2, "p23": 0.4, "p14": 0.01}
    chain = {"to_bad": 0.02, "to_good": 0.2, "loss_good": 0.01, "loss_bad": 0.8}
    models: dict[str, tuple[dict[str, Any], Any]] = {
        "delay 100ms": (
            {"fault": "delay", "value": 0.1},
            lambda t, s: (None, np.full(len(t), 0.1)),
        ),
        "delay 100ms 20ms": (
            {**jitter, "base_s": 0.08, "value": 0.04},
            lambda t, s: (None, rng.uniform(0.08, 0.12, len(t))),
        ),
        "the same, 50% alike": (
            {**jitter, "base_s": 0.08, "value": 0.04, "correlation": 0.5},
            lambda t, s: (None, rng.uniform(0.08, 0.12, len(t))),
        ),
        "pareto of shape 3": (
            {**jitter, "base_s": 0.05, "value": 0.02, "distribution": "pareto"},
            lambda t, s: (None, 0.05 + 0.02 * rng.pareto(3, len(t))),
        ),
        "loss 10%": (
            {"fault": "drop", "value": 0.1},
            lambda t, s: (rng.random(len(t)) < 0.1, np.zeros(len(t))),
        ),
        "loss 10%, 50% alike": (
            {"fault": "drop", "value": 0.1, "correlation": 0.5},
            lambda t, s: (rng.random(len(t)) < 0.1, np.zeros(len(t))),
        ),
        "bit errors 1e-4": (
            {"fault": "bit-errors", "value": 1e-4},
            lambda t, s: (rng.random(len(t)) >= (1 - 1e-4) ** (8 * s), np.zeros(len(t))),
        ),
        "loss gemodel": (
            {"fault": "gilbert-elliott", **chain},
            lambda t, s: (chain_of(len(t), rng), np.zeros(len(t))),
        ),
        "loss state": (
            {"fault": "four-state-loss", **states},
            lambda t, s: (states_of(len(t), rng), np.zeros(len(t))),
        ),
        "reorder 50% gap 4": (
            {"fault": "reorder", "value": 0.5, "by_s": 0.1, "gap": 4},
            lambda t, s: (None, reorder_of(len(t), rng)),
        ),
        "rate": ({**rate, "queue_s": 1e6}, lambda t, s: (None, rate_of(t, s))),
        "rate, less 12 a frame": (
            {**rate, "queue_s": 1e6, "overhead_bytes": -12},
            lambda t, s: (None, rate_of(t, s, -12)),
        ),
        "rate 42 48 5": (
            {**rate, "queue_s": 1e6, "cell_bytes": CELL, "cell_overhead_bytes": CELL_OVERHEAD},
            lambda t, s: (None, rate_of(t, s, cell=CELL)),
        ),
        "mpu 64": (
            {**rate, "queue_s": 1e6, "overhead_bytes": 0, "least_bytes": LEAST},
            lambda t, s: (None, rate_of(t, s, 0, least=LEAST)),
        ),
        "rate, limit 20": ({**rate, "queue_frames": 20}, lambda t, s: queue_of(t, s, 20)),
        "normal 100ms 20ms": (
            {**jitter, "base_s": 0.1, "value": 0.02, "distribution": "normal"},
            lambda t, s: (None, rng.normal(0.1, 0.02, len(t))),
        ),
        "paretonormal 110 20ms": (
            {**jitter, "base_s": 0.1, "value": 0.02, "distribution": "pareto-normal"},
            lambda t, s: (None, 0.11 + 0.02 * pareto_normal(len(t), rng)),
        ),
        "slot 20ms 80ms": (
            {"fault": "slots", "base_s": 0.02, "value": 0.06},
            lambda t, s: (None, slots_of(t, s, lambda: rng.uniform(0.02, 0.08))),
        ),
        "slot, bytes 2000": (
            {"fault": "slots", "base_s": 0.02, "value": 0.06, "bytes": 2000},
            lambda t, s: (None, slots_of(t, s, lambda: rng.uniform(0.02, 0.08), 2000)),
        ),
        "slot normal 50ms 10ms": (
            {"fault": "slots", "base_s": 0.05, "value": 0.01, "distribution": "normal"},
            lambda t, s: (None, slots_of(t, s, lambda: rng.normal(0.05, 0.01))),
        ),
    }  # fmt: skip
    print(f"{'model':24}{'stamps':>8}{'netem':>9}{'ours':>9}{'netem':>10}{'ours':>10}")
    for hertz in STAMP_HZ:
        traces = [make_frames(one, hertz, seconds) for one in make_traces(seconds).values()]
        for name, (fault, model) in models.items():
            theirs, ours = np.zeros(3), np.zeros(3)  # bytes, frames, sum of delays
            for frames in traces:
                times = np.array([t_s for t_s, _ in frames])
                sizes = np.array([len(raw) for _, raw in frames])
                lost, late = model(times, sizes)
                left = np.ones(len(times), bool) if lost is None else ~lost
                theirs += sizes[left].sum(), left.sum(), late[left].sum()
                for t_s, due_s, size in pass_model(frames, [fault]):
                    ours += size, 1, due_s - t_s
            delay_ms = [1e3 * total / count for _, count, total in (theirs, ours)]
            print(
                f"{name:24}{hertz:6.1f}Hz{theirs[0] / 1e3:7.0f}kB{ours[0] / 1e3:7.0f}kB"
                f"{delay_ms[0]:8.1f}ms{delay_ms[1]:8.1f}ms"
            )
            late = abs(delay_ms[1] - delay_ms[0]) / max(delay_ms[0], SHORT_MS)
            worst = max(worst, abs(ours[0] / theirs[0] - 1), late)
    return worst


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--kernel", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.kernel is not None:
        given = [(t_s, bytes.fromhex(raw)) for t_s, raw in json.load(sys.stdin)]
        print(json.dumps(pass_kernel(given, bool(arguments.kernel))))
    else:
        print(f"largest difference: {compare_with_netem(6 * arguments.seconds):.1%}")
        for with_peak in (False, True):
            worst = compare_with_tbf(arguments.seconds, peak=with_peak)
            print(f"largest difference{', with a peak rate' * with_peak}: {worst:.1%}", flush=True)
