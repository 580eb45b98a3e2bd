"""Streams with one peer pass in machine code, all else and what the kernel refuses by the core."""

import contextlib
import random
import socket
from collections.abc import Iterator

import pytest

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.server import Server
from mavproxy_fault.compiled.object_file import load, make
from mavproxy_fault.links.tcp import TcpClient, TcpServer
from mavproxy_fault.links.udp import UdpServer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    make()
    assert load() is not None


class Pair:
    """A proxy between two TCP connections, of which the test drives the loop."""

    def __init__(self, buffer: int = 0) -> None:
        listener = socket.socket()
        if buffer:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        self.links = [TcpServer("127.0.0.1", 0), TcpClient(*listener.getsockname())]
        self.station = listener.accept()[0]
        listener.close()
        self.vehicle = socket.create_connection(("127.0.0.1", self.links[0].port))
        for end in (self.station, self.vehicle):
            end.setblocking(False)
        self.core = Core(link_roles(self.links))
        self.server = Server(self.links, self.core)
        self.server.use_compiled()
        while not all(link.peer_count for link in self.links):
            self.server._step()

    def arrived(self, count: int) -> bytes:
        """What the station receives, at least so many bytes."""
        came = b""
        while len(came) < count:
            self.server._step()
            with contextlib.suppress(BlockingIOError):
                came += self.station.recv(65_536)
        return came

    def close(self) -> None:
        for one in (*self.links, self.station, self.vehicle):
            one.close()


@pytest.fixture
def pair() -> Iterator[Pair]:
    found = Pair()
    yield found
    found.close()


def frames(count: int) -> list[bytes]:
    layout = message_layout("ATTITUDE")
    return [
        build_frame(layout, {"time_boot_ms": n + 1, "yaw": n / 7}, seq=n % 256)
        for n in range(count)
    ]


def test_whole_frames_never_reach_the_core(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    first, *rest = frames(200)
    pair.vehicle.send(first)
    assert pair.arrived(len(first)) == first
    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(pair.core, "_process", None)  # it would fail
        for one in rest:
            pair.vehicle.send(one)
        assert pair.arrived(sum(map(len, rest))) == b"".join(rest)
    pair.server._maintain_links()
    assert pair.core.states[0].frames == 200
    assert pair.links[0].counters.bytes_in == sum(map(len, frames(200)))


def test_a_stream_that_is_cut_anywhere_passes_unchanged(pair: Pair) -> None:
    rng, left = random.Random(3), b"".join(frames(300)) + b"junk" + b"".join(frames(20))
    sent = left
    while left:
        size = rng.randrange(1, 400)
        pair.vehicle.send(left[:size])
        left = left[size:]
        pair.server._step()
    assert pair.arrived(len(sent)) == sent


def test_what_a_slow_peer_does_not_take_follows_in_order() -> None:
    pair = Pair(buffer=4096)
    pair.links[1]._peer[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    try:
        sent = b"".join(frames(8000))
        left = sent
        while left:
            with contextlib.suppress(BlockingIOError):
                left = left[pair.vehicle.send(left[:4000]) :]
            pair.server._step()
        assert pair.links[1]._peer[1].has_pending, "the kernel has not taken all"
        assert pair.arrived(len(sent)) == sent
        assert pair.links[1].counters.drops == 0
    finally:
        pair.close()


def test_an_ended_connection_and_another_one_are_found(pair: Pair) -> None:
    first, second = frames(2)
    pair.vehicle.send(first)
    assert pair.arrived(len(first)) == first
    pair.vehicle.close()
    while pair.links[0].peer_count:
        pair.server._step()
    pair.vehicle = socket.create_connection(("127.0.0.1", pair.links[0].port))
    pair.vehicle.send(second)
    assert pair.arrived(len(second)) == second


def test_a_new_senders_frame_stays_before_those_that_machine_code_writes() -> None:
    master, outlet = UdpServer("127.0.0.1", 0), TcpServer("127.0.0.1", 0)
    server = Server([master, outlet], Core(link_roles([master, outlet])))
    server.use_compiled()
    sent = b"".join(frames(20))
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.create_connection(("127.0.0.1", outlet.port)) as peer,
    ):
        while not outlet.peer_count:
            outlet.read()
        for one in frames(20):
            vehicle.sendto(one, ("127.0.0.1", master.port))
        peer.setblocking(False)
        came = b""
        while len(came) < len(sent):
            server._step()
            with contextlib.suppress(BlockingIOError):
                came += peer.recv(65_536)
    assert came == sent
    master.close()
    outlet.close()
