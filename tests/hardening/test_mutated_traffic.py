"""Mutated MAVLink on every kind of link neither ends nor stalls the proxy.

Marks, frames that no fault acts on, are sent between the mutated bytes. Each must leave exactly
once, in order, unchanged, and soon. The time of a mark includes waiting for a processor; the
processor time of the process is printed beside it.
`HARDENING_BYTES=125000000 pytest -s --timeout 0 tests/hardening/test_mutated_traffic.py` is the
long form: 10^9 bytes through the eight.
"""

import contextlib
import os
import pty
import random
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.server import Server
from mavproxy_fault.compiled.object_file import load, make
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.links.link import Link, enlarge_buffers
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.proxy.core import Core, LinkRole
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout, message_names
from mavproxy_fault.wire.frame import HEADER_V2, SIGNATURE_LENGTH, Frame, build_frame
from mavproxy_fault.wire.signing import derive_key
from tests.signed_frames import sign_frame

BYTES = int(os.environ.get("HARDENING_BYTES", "150000"))
BETWEEN = 10 if BYTES < 1_000_000 else 100  # datagrams: on a stream a mark may be delayed by 0.2 s
TIMEOUT_S = 20.0  # on a busy machine
LONGEST = HEADER_V2 + 255 + 2 + SIGNATURE_LENGTH  # bytes of a frame
MARKED = 42  # the system that sends marks
EDGES = [0, 1, 1 << 31, 10**15 - 1, 10**15, 1 << 53, (1 << 63) - 1, 1 << 63, (1 << 64) - 1]
NAMES = ["HIL_SENSOR", "HIL_GPS", "ATTITUDE", "VFR_HUD", "SCALED_IMU", "GPS_RAW_INT", "TUNNEL"]

Write = Callable[[bytes], object]


def frame(rng: random.Random, seq: int) -> bytes:
    """A frame with an extreme timestamp or none, of version 1 or 2, signed or not."""
    name = rng.choice(NAMES) if rng.random() < 0.8 else rng.choice(message_names())
    described = message_layout(name)
    payload = bytearray(rng.randbytes(described.length))
    stamp = described.fields.get("time_usec") or described.fields.get("time_boot_ms")
    if stamp is not None:
        limit = (1 << 8 * stamp.size) - 1
        wild = rng.choice(EDGES) if rng.random() < 0.1 else 1_000_000 + 4000 * seq
        payload[stamp.offset : stamp.offset + stamp.size] = min(wild, limit).to_bytes(
            stamp.size, "little"
        )
    system = rng.choice([1, 1, 1, 2, rng.randrange(43, 256)])
    shell = Frame(build_frame(described, {}, seq=seq & 255, system=system, component=1), described)
    made = shell.with_payload(bytes(payload).rstrip(b"\0") or b"\0")
    if rng.random() < 0.1:
        return sign_frame(made, derive_key("phrase"), 1, 10**12 + seq).raw
    return made.raw


def mutated(rng: random.Random, seq: int) -> bytes:
    """Frames, some of them with flipped bits, cut, duplicated or merged."""
    data = b"".join(frame(rng, seq + n) for n in range(rng.choice([1, 1, 2, 5])))
    for _ in range(rng.choice([0, 0, 1, 3])):
        at = rng.randrange(len(data))
        cut = data[at : at + rng.randrange(1, 20)]
        data = rng.choice(
            [data[:at] + rng.randbytes(1) + data[at + 1 :], data[:at] + cut + data[at:],
             data[at:] + data[:at], data[:at] or b"\xfd", data + rng.randbytes(9)]
        )  # fmt: skip
    return data


def mark(number: int) -> bytes:
    values = {"type": number & 255, "custom_mode": number}
    return build_frame(
        message_layout("HEARTBEAT"), values, seq=number & 255, system=MARKED, component=7
    )


def sixteen() -> str:
    """A schedule of so many different faults, each on messages that the traffic has."""
    lines = ["seed: 1", "faults:"]
    for name, kind in known_faults().items():
        example = getattr(kind, "example", None)
        if kind.acts_on == "fields" and example and len(lines) < 18:
            lines.append(f"  - {{id: {name}, fault: {name}, **}}".replace("**", written(example)))
    return "\n".join(lines)


def written(example: dict[str, object]) -> str:
    return ", ".join(f"{key}: {value}" for key, value in example.items())


@contextlib.contextmanager
def master(kind: str) -> Iterator[tuple[Link, Write]]:
    """The vehicle's link of one kind, and how a vehicle writes to it."""
    if kind == "pty":
        end, device = pty.openpty()
        tty.setraw(device)
        link = open_link(f"{os.ttyname(device)},57600")
        try:
            yield link, lambda data: write_all(end, data)
        finally:
            os.close(end)
            os.close(device)
    elif kind == "tcp":
        link = open_link("tcpin:127.0.0.1:0")
        port = int(link.name.rsplit(":", 1)[1])
        with socket.create_connection(("127.0.0.1", port)) as peer:
            yield link, peer.sendall
    else:
        link = open_link("udpin:127.0.0.1:0")
        port = int(link.name.rsplit(":", 1)[1])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.connect(("127.0.0.1", port))
            yield link, sock.send


def write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


@contextlib.contextmanager
def proxy(link: Link, schedule: str, *, compiled: bool) -> Iterator[socket.socket]:
    """A proxy's loop in a thread; the station it sends to."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(TIMEOUT_S)
        enlarge_buffers(station)
        links = [link, open_link(f"udpout:127.0.0.1:{station.getsockname()[1]}")]
        engine = Engine(parse_schedule(schedule)) if schedule else None
        server = Server(links, Core(link_roles(links), engine))
        if compiled:
            server.use_compiled()
        failures: list[BaseException] = []

        def work() -> None:
            try:
                server.run()
            except BaseException as error:
                failures.append(error)

        loop = threading.Thread(target=work)
        loop.start()
        try:
            yield station
        finally:
            server.stop()
            loop.join(TIMEOUT_S)
            for one in links:
                one.close()
            assert not loop.is_alive()
            assert not failures, failures
            if engine is not None:
                assert {one["id"]: one["failure"] for one in engine.state()["faults"]
                        if one.get("failure")} == {}  # fmt: skip


@pytest.mark.parametrize("schedule", [False, True], ids=["no fault", "16 faults"])
@pytest.mark.parametrize("kind", ["udp", "udp compiled", "tcp", "pty"])
def test_marks_between_mutated_bytes_leave_once_in_order_and_soon(
    kind: str, schedule: bool
) -> None:
    if kind == "udp compiled":
        make()
        assert load() is not None
    rng = random.Random(f"{kind} {schedule}")
    # On a stream a header without its end takes what follows, and where its message is unknown one
    # in 256 passes for a frame, on which a fault may act: none reaches from before to a mark.
    apart = b"" if kind.startswith("udp") else bytes(LONGEST)
    sent = number = 0
    slowest = (0.0, 0.0)  # seconds, and how many of them this process computed
    longest_s = 0.0  # computed for one mark
    with (
        master(kind.split()[0]) as (link, write),
        proxy(link, sixteen() if schedule else "", compiled=kind == "udp compiled") as station,
    ):
        write(mark(0))
        while sent < BYTES:
            for _ in range(BETWEEN):
                data = mutated(rng, sent // 30)
                write(data)
                sent += len(data)
            number += 1
            begun_s, computed_s = time.monotonic(), time.process_time()
            write(apart + mark(number))
            received = b""
            while mark(number) not in received:
                received += station.recv(65_535)
            computed_s = time.process_time() - computed_s
            slowest = max(slowest, (time.monotonic() - begun_s, computed_s))
            longest_s = max(longest_s, computed_s)
            marks = [n for n in range(max(number - 3, 0), number + 2) if mark(n) in received]
            assert marks in ([number], [0, 1]), marks
            assert received.count(mark(number)) == 1
    print(
        f"{kind}, {16 * schedule} faults: {sent} bytes, {number} marks, "
        f"slowest {slowest[0]:.3f} s, of which {slowest[1]:.3f} s computed, at most {longest_s:.3f}"
    )


def test_a_stream_split_at_any_byte_gives_the_same_output_with_16_faults() -> None:
    schedule, rng = parse_schedule(sixteen()), random.Random(2)
    stream = b"".join(mutated(rng, n) for n in range(6))
    now_us = 10**15

    def given(*pieces: bytes) -> bytes:
        sides = LinkRole("vehicle", "from-vehicle", datagrams=False), LinkRole("sim", "to-vehicle")
        core = Core(sides, Engine(schedule))
        sends = [send for data in (*pieces, b"") for send in core.received(0, data, now_us)]
        return b"".join(send.data for send in [*sends, *core.finish(now_us + 10**7)])

    expected = given(stream)
    assert expected != stream
    every = 40 if BYTES < 1_000_000 else 1
    for at in range(1, len(stream), every):
        assert given(stream[:at], stream[at:]) == expected, at
    assert given(*(stream[at : at + 1] for at in range(len(stream)))) == expected
