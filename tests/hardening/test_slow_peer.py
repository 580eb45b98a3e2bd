"""Delays and a rate limit on TCP while one peer reads too slowly: the other one does not notice.

`FRAMES=400000 PER_S=4000 pytest -s --timeout 0 tests/hardening/test_slow_peer.py` is the long form.
It prints how late frames came to the peer that reads, and what became of the slow one.
"""

import contextlib
import os
import selectors
import socket
import threading
import time
from statistics import median

from mavproxy_fault.links.link import QUEUE_LIMIT
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from tests.mavproxy_fault.serving import TIMEOUT_S, serving

FRAMES = int(os.environ.get("FRAMES", "8000"))
PER_S = float(os.environ.get("PER_S", "inf"))
DELAY_S, JITTER_S, LIMIT_PER_S = 0.3, 0.2, 500
SCHEDULE = f"""
seed: 1
faults:
  - {{fault: delay, target: HIL_SENSOR, value: {DELAY_S}}}
  - {{fault: jitter, target: RAW_IMU, value: {JITTER_S}}}
  - {{fault: rate-limit, target: HIL_GPS, value: {LIMIT_PER_S}, queue_s: 1000}}
"""
# Of a hundred frames: the limit is for less than comes, and most are as large as can be.
KINDS = ["HIL_SENSOR", "RAW_IMU", "HIL_GPS", "HEARTBEAT"] * 5 + ["FILE_TRANSFER_PROTOCOL"] * 80
LARGE = bytes(range(1, 252))


def frame(kind: str, number: int, now_s: float) -> bytes:
    values: dict[str, object] = {"time_usec": round(now_s * 1e6)}
    if kind == "HEARTBEAT":
        values = {"type": 2, "custom_mode": number}
    elif kind == "FILE_TRANSFER_PROTOCOL":
        values = {"payload": LARGE}
    return build_frame(message_layout(kind), values, seq=number & 255)


def send(vehicle: socket.socket, sent_s: dict[str, list[float]]) -> None:
    """A hundred frames at a time, at most `PER_S` in a second."""
    begun_s = time.monotonic()
    for number in range(FRAMES):
        if number % 100 == 0 and (wait_s := begun_s + number / PER_S - time.monotonic()) > 0.0:
            time.sleep(wait_s)
        kind, now_s = KINDS[number % 100], time.monotonic()
        sent_s[kind].append(now_s)
        vehicle.sendall(frame(kind, number, now_s))


def test_a_peer_that_reads_too_slowly_delays_and_loses_nothing_of_the_others() -> None:
    links = [open_link("tcpin:127.0.0.1:0") for _ in range(3)]
    ports = [int(link.name.rsplit(":", 1)[1]) for link in links]
    sent_s: dict[str, list[float]] = {kind: [] for kind in KINDS}
    came_s: dict[str, list[float]] = {kind: [] for kind in KINDS}
    parsers = {name: Parser() for name in ("quick", "slow")}
    numbers = []
    with contextlib.ExitStack() as opened:
        running = opened.enter_context(serving(links, Engine(parse_schedule(SCHEDULE))))
        vehicle, slow, quick = (
            opened.enter_context(socket.create_connection(("127.0.0.1", port))) for port in ports
        )
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        while [link.peer_count for link in links] != [1, 1, 1]:
            pass
        sender = threading.Thread(target=send, args=(vehicle, sent_s))
        sender.start()
        selector = opened.enter_context(selectors.DefaultSelector())
        selector.register(quick, selectors.EVENT_READ)
        most_queued, next_s = 0, 0.0
        while sum(map(len, came_s.values())) < FRAMES:
            assert selector.select(TIMEOUT_S), "the peer that reads is starved"
            data, now_s = quick.recv(1 << 16), time.monotonic()
            for item in parsers["quick"].push(data):
                assert isinstance(item, Frame)
                if item.layout.name == "STATUSTEXT":  # the proxy's own
                    continue
                came_s[item.layout.name].append(now_s)
                if item.layout.name == "HEARTBEAT":
                    numbers.append(item.number("custom_mode"))
            if now_s > next_s:  # two kilobytes ten times a second
                next_s = now_s + 0.1
                parsers["slow"].push(slow.recv(2048))
            [(_, stream, _)] = links[1]._peers.values()
            most_queued = max(most_queued, stream._queued)
        sender.join()
        drops = links[1].counters.drops
    assert numbers == [n for n in range(FRAMES) if KINDS[n % 100] == "HEARTBEAT"]
    assert {kind: len(times) for kind, times in came_s.items()} == {
        kind: len(times) for kind, times in sent_s.items()
    }
    least_s = {"HIL_SENSOR": DELAY_S, "RAW_IMU": 0.0, "HEARTBEAT": 0.0}
    for kind, delay_s in least_s.items():
        late_s = [c - s - delay_s for s, c in zip(sent_s[kind], came_s[kind], strict=True)]
        assert min(late_s) > -0.002  # never before it was due
        print(f"{kind}: late by {median(late_s) * 1e3:.2f} ms, at most {max(late_s) * 1e3:.1f} ms")
    spent_s = came_s["HIL_GPS"][-1] - came_s["HIL_GPS"][0]
    assert (len(came_s["HIL_GPS"]) - 1) / spent_s < LIMIT_PER_S * 1.02
    # Whole frames alone came to the slow one, and no more than its queue holds waited for it.
    assert parsers["slow"].counters.junk_bytes == 0
    assert most_queued <= QUEUE_LIMIT
    print(f"slow peer: {drops} dropped of {FRAMES}, {most_queued} bytes waited at most")
    assert running.core.states[0].frames == FRAMES
    assert drops > 0 or FRAMES < 30_000  # what fits the queue and the system's buffers
