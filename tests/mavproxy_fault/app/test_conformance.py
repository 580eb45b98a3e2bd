"""Conformance of a MAVLink proxy process over real sockets.

Each case is one that an existing router gets wrong. To ask another proxy, give its command with
the two addresses it shall use, e.g.

    MAVPROXY_FAULT_CONFORMANCE="mavlink-routerd -e {out} {master_host}:{master_port}"

The proxy listens at {master} and sends to {out} (`{master_host}`, `{master_port}`, `{out_host}`,
`{out_port}` are their parts).
"""

import os
import select
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.signing import derive_key
from tests.signed_frames import sign_frame

OURS = f"{sys.executable} -m mavproxy_fault.cli proxy --master udpin:{{master}} --to udpout:{{out}}"
COMMAND = os.environ.get("MAVPROXY_FAULT_CONFORMANCE", f"{OURS} --zenoh off")
PATIENCE_S = 5.0


def frame(name: str, seq: int = 0, system: int = 1, component: int = 1, **values: object) -> bytes:
    return build_frame(message_layout(name), values, seq=seq, system=system, component=component)


def heartbeat(seq: int = 0, system: int = 1, component: int = 1) -> bytes:
    return frame("HEARTBEAT", seq, system, component, type=2, autopilot=12, mavlink_version=3)


def with_flags(raw: bytes, flags: int) -> bytes:
    """Build a frame with incompatibility flags and a valid CRC."""
    layout = message_layout(int.from_bytes(raw[7:10], "little"))
    changed = Frame(raw[:2] + bytes((flags,)) + raw[3:], layout)
    return changed.with_payload(changed.payload).raw


END = frame("STATUSTEXT", 99, 9, 9, text=b"end of the case")
BROKEN = bytes((*heartbeat()[:-1], heartbeat()[-1] ^ 0xFF))
SENSOR = frame("HIL_SENSOR", 1, 1, 51, time_usec=10**6, xgyro=0.1, fields_updated=63)
ZEROS = Frame(heartbeat(), message_layout("HEARTBEAT")).with_payload(b"\2\0\0\0\2\0\0\0\0").raw
FUTURE = Frame(heartbeat(), message_layout("HEARTBEAT")).with_payload(bytes(range(1, 20))).raw
UNKNOWN = b"\xfd\x03\0\0\x05\x01\x01\x99\x99\x09abc"
UNKNOWN += bytes.fromhex("4d50")  # with a CRC extra of 0x55


@dataclass
class Ends:
    """The two sides of a running proxy: `vehicle` talks to the master, `station` is the output."""

    vehicle: socket.socket
    station: socket.socket
    process: subprocess.Popen[bytes]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        port: int = place.getsockname()[1]
        return port


@pytest.fixture
def ends() -> Iterator[Ends]:
    vehicle, station = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    station.bind(("127.0.0.1", 0))
    master, out = free_port(), station.getsockname()[1]
    command = COMMAND.format(
        master=f"127.0.0.1:{master}",
        out=f"127.0.0.1:{out}",
        master_host="127.0.0.1",
        master_port=master,
        out_host="127.0.0.1",
        out_port=out,
    )
    process = subprocess.Popen(shlex.split(command), stdout=subprocess.DEVNULL)
    vehicle.bind(("127.0.0.1", 0))
    vehicle.connect(("127.0.0.1", master))
    ends = Ends(vehicle, station, process)
    _wait_until_it_forwards(ends)
    yield ends
    process.send_signal(signal.SIGINT)
    process.wait(10)
    ends.vehicle.close()
    ends.station.close()


def _wait_until_it_forwards(ends: Ends) -> None:
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and ends.process.poll() is None:
        try:
            ends.vehicle.send(heartbeat(system=7, component=7))
        except ConnectionRefusedError:
            continue
        if select.select([ends.station], [], [], 0.05)[0]:
            _, address = ends.station.recvfrom(65535)
            ends.station.connect(address)
            ends.station.send(heartbeat(system=255, component=190))
            until(ends.vehicle, heartbeat(system=255, component=190))
            return
    pytest.fail(f"no frame came through {COMMAND}")


def until(sock: socket.socket, last: bytes) -> bytes:
    """Receive all bytes up to a marker that is sent at the end."""
    got = b""
    while last not in got:
        if not select.select([sock], [], [], PATIENCE_S)[0]:
            pytest.fail(f"{last!r} is missing after {got!r}")
        got += sock.recv(65535)
    return got[: got.rindex(last)]


def passed(ends: Ends, *datagrams: bytes) -> bytes:
    """Send datagrams from the vehicle and return what the station receives."""
    ends.vehicle.send(frame("STATUSTEXT", 98, 9, 9, text=b"start"))
    until(ends.station, frame("STATUSTEXT", 98, 9, 9, text=b"start"))
    for data in datagrams:
        ends.vehicle.send(data)
    ends.vehicle.send(END)
    return until(ends.station, END)


ONE_BY_ONE = {
    "a known message with a wrong CRC": (BROKEN,),
    "several frames in one datagram": (heartbeat(1) + SENSOR + heartbeat(2),),
    "a datagram beyond 1120 bytes": (b"".join(heartbeat(seq) for seq in range(200)), SENSOR),
    "a broken frame, then a good one in one datagram": (BROKEN + SENSOR,),
    "an unknown incompatibility flag": (with_flags(heartbeat(), 0x02), SENSOR),
    "zeros that the sender did not cut": (ZEROS, SENSOR),
    "extension bytes of the future": (FUTURE, SENSOR),
    "a message of another dialect": (UNKNOWN, SENSOR),
    "bytes that are no MAVLink": (b"\r\nboot: \xfe\xfd fine\r\n", SENSOR),
    "a signed frame": (
        sign_frame(Frame(SENSOR, message_layout("HIL_SENSOR")), derive_key("k"), 1, 5).raw,
    ),
    "a length that reaches beyond the datagram": (b"\xfd\xff\0\0\1\1\1\0\0\0", SENSOR),
    "MAVLink 1": (bytes.fromhex("fe0900013300000000000203510403aee1"), SENSOR),
}


@pytest.mark.parametrize("case", ONE_BY_ONE)
def test_every_byte_is_forwarded_unchanged(case: str, ends: Ends) -> None:
    assert passed(ends, *ONE_BY_ONE[case]) == b"".join(ONE_BY_ONE[case])


def test_a_frame_for_an_unknown_system_is_forwarded(ends: Ends) -> None:
    request = frame("PARAM_REQUEST_LIST", target_system=77, target_component=1)
    assert passed(ends, request) == request


def test_a_sender_on_both_sides_is_forwarded(ends: Ends) -> None:
    ends.station.send(heartbeat(5))
    until(ends.vehicle, heartbeat(5))
    data = b"".join(heartbeat(seq) for seq in range(10, 20))
    assert passed(ends, *(heartbeat(seq) for seq in range(10, 20))) == data


def test_every_client_of_a_server_port_is_served(ends: Ends) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        second.connect(ends.vehicle.getpeername())
        second.send(heartbeat(1, component=2))
        until(ends.station, heartbeat(1, component=2))
        ends.station.send(heartbeat(9, system=255))
        until(second, heartbeat(9, system=255))
        until(ends.vehicle, heartbeat(9, system=255))


def test_bursts_lose_nothing(ends: Ends) -> None:
    # The default socket buffer: more would be lost in the kernel.
    for start in range(0, 2000, 200):
        burst = range(start, start + 200)
        frames = [frame("HIL_SENSOR", n & 255, 1, 51, time_usec=n + 1) for n in burst]
        assert passed(ends, *frames) == b"".join(frames)


def test_an_endpoint_that_restarts_is_served_again(ends: Ends) -> None:
    proxy, address = ends.station.getpeername(), ends.station.getsockname()
    ends.station.close()
    for seq in range(20):
        ends.vehicle.send(heartbeat(seq))
    ends.station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ends.station.bind(address)
    ends.station.connect(proxy)
    assert passed(ends, SENSOR).endswith(SENSOR)
