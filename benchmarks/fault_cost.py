"""What ten faults on one message cost a frame: python benchmarks/fault_cost.py

Processor time of the forwarding thread, the least of some stretches; system calls are within the
compiled figure, none in the interpreted one.
"""

import contextlib
import socket
import time

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.server import Server
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

FRAMES, BATCH, STRETCH = 19_200, 64, 1920
SIMPLE = ["bias", "scale", "drift", "noise", "constant"]
FIELDS = ["xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag", "abs_pressure"]
SCHEDULES = {
    "none": "",
    "ten that are compiled": "faults:\n" + "".join(
        f"  - {{fault: {SIMPLE[n % 5]}, target: HIL_SENSOR.{name}, value: 0.1}}\n"
        for n, name in enumerate(FIELDS)
    ),
    "ten of different kinds": """faults:
  - {fault: bias, target: HIL_SENSOR.xgyro, value: 0.1}
  - {fault: scale, target: HIL_SENSOR.ygyro, value: 1.3}
  - {fault: drift, target: HIL_SENSOR.zgyro, value: 0.0001}
  - {fault: noise, target: HIL_SENSOR.xacc, value: 1}
  - {fault: freeze, target: HIL_SENSOR.abs_pressure}
  - {fault: constant, target: HIL_SENSOR.yacc, value: 3.0}
  - {fault: quantise, target: HIL_SENSOR.zacc, value: 0.25}
  - {fault: sine, target: HIL_SENSOR.xmag, value: 0.1, frequency_hz: 10}
  - {fault: saturate, target: HIL_SENSOR.ymag, value: 0.05}
  - {fault: dead-band, target: HIL_SENSOR.zmag, value: 0.05}
""",
}  # fmt: skip


def traffic() -> list[bytes]:
    """HIL_SENSOR at 250 Hz."""
    values = dict.fromkeys(FIELDS, 0.3)
    return [
        build_frame(
            message_layout("HIL_SENSOR"), {"time_usec": 1_000_000 + 4000 * n, **values}, seq=n & 255
        )
        for n in range(FRAMES)
    ]


def interpreted_us(text: str, frames: list[bytes]) -> float:
    """Microseconds per frame through the core."""
    ends = [LinkRole("vehicle", "from-vehicle", True), LinkRole("station", "to-vehicle", True)]
    core = Core(ends, Engine(parse_schedule(text)) if text else None)
    best_s = float("inf")
    for first in range(0, FRAMES, STRETCH):
        begun_s = time.thread_time()
        for n in range(first, first + STRETCH):
            core.received(0, frames[n], 1_000_000 + 4000 * n)
        best_s = min(best_s, time.thread_time() - begun_s)
    return best_s / STRETCH * 1e6


def compiled_us(text: str, frames: list[bytes]) -> float:
    """Microseconds per frame through the machine code, from socket to socket."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        station.bind(("127.0.0.1", 0))
        station.setblocking(False)
        links = [
            open_link("udpin:127.0.0.1:0"),
            open_link(f"udpout:127.0.0.1:{station.getsockname()[1]}"),
        ]
        vehicle.connect(("127.0.0.1", int(links[0].name.rsplit(":", 1)[1])))
        server = Server(
            links, Core(link_roles(links), Engine(parse_schedule(text)) if text else None)
        )
        server.use_compiled()
        best_s = min(stretch_s(server, frames[n : n + STRETCH], vehicle, station)
                     for n in range(0, FRAMES, STRETCH))  # fmt: skip
        for link in links:
            link.close()
        return best_s / STRETCH * 1e6


def stretch_s(
    server: Server, frames: list[bytes], vehicle: socket.socket, station: socket.socket
) -> float:
    """Seconds that the forwarding thread computed for some frames."""
    forwarder = server._forwarder
    assert forwarder is not None
    spent_s = 0.0
    for first in range(0, len(frames), BATCH):
        for raw in frames[first : first + BATCH]:
            vehicle.send(raw)
        passed = 0
        while passed < BATCH:
            begun_s = time.thread_time()
            forwarder.forward(time.monotonic_ns() + 300_000, spin=False)
            # Only the first frames are handed over: they begin the faults.
            if forwarder.pending:
                number, data, _ = forwarder.handed_over()
                server._send_all(server.core.received(number, data, server.now_us()))
            spent_s += time.thread_time() - begun_s
            with contextlib.suppress(BlockingIOError):
                while station.recv(999):
                    passed += 1
    return spent_s


def main() -> None:
    """Measure and print."""
    frames = traffic()
    for name, text in SCHEDULES.items():
        print(f"{name}: interpreted {interpreted_us(text, frames):.1f} us", end="")
        print("" if "kinds" in name else f", compiled {compiled_us(text, frames):.1f} us")


if __name__ == "__main__":
    main()
