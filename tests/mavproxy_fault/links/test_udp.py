import select
import socket
from collections.abc import Iterator

import pytest

from mavproxy_fault.links.peers import MAX_PEERS, PEER_EXPIRY_S
from mavproxy_fault.links.udp import UdpClient, UdpServer


@pytest.fixture
def server() -> Iterator[UdpServer]:
    link = UdpServer("127.0.0.1", 0)
    yield link
    link.close()


@pytest.fixture
def sockets() -> Iterator[list[socket.socket]]:
    made = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    for sock in made:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5)
    yield made
    for sock in made:
        sock.close()


def ready(link: UdpServer | UdpClient) -> bool:
    return bool(select.select(link.filenos(), [], [], 5)[0])


def test_a_server_keeps_the_boundaries_of_datagrams(
    server: UdpServer, sockets: list[socket.socket]
) -> None:
    sockets[0].sendto(b"one", ("127.0.0.1", server.port))
    sockets[0].sendto(b"two", ("127.0.0.1", server.port))
    assert ready(server)
    assert server.read() == [(0, b"one"), (0, b"two")]
    assert server.read() == []


def test_a_server_answers_every_peer_it_has_heard(
    server: UdpServer, sockets: list[socket.socket]
) -> None:
    for sock in sockets:
        sock.sendto(b"hello", ("127.0.0.1", server.port))
    assert ready(server)
    server.read()
    server.write(b"answer")
    assert [sock.recv(99) for sock in sockets] == [b"answer"] * 3
    assert server.peer_count == 3


def test_a_server_without_peers_counts_what_it_drops(server: UdpServer) -> None:
    server.write(b"without peers")
    assert (server.counters.drops, server.counters.chunks_out) == (1, 0)


def test_a_server_drops_silent_peers_but_never_the_latest(server: UdpServer) -> None:
    server.peers.register(b"old", b"", 0.0)
    server.peers.register(b"newer", b"", 1.0)
    server.peers.register(b"new", b"", PEER_EXPIRY_S + 0.5)
    assert list(server.peers.by_address) == [b"newer", b"new"]
    server.peers.register(b"late", b"", 10 * PEER_EXPIRY_S)
    assert list(server.peers.by_address) == [b"new", b"late"]


def test_a_server_keeps_a_bounded_number_of_peers(server: UdpServer) -> None:
    for number in range(2 * MAX_PEERS):
        server.peers.register(b"%d" % number, b"", float(number) / 1000)
    assert list(server.peers.by_address) == [b"%d" % n for n in range(MAX_PEERS, 2 * MAX_PEERS)]


def test_a_client_survives_a_peer_that_comes_and_goes() -> None:
    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer.bind(("127.0.0.1", 0))
    address = peer.getsockname()
    link = UdpClient(*address)
    link.write(b"one")
    assert peer.recv(99) == b"one"
    peer.close()
    link.write(b"without peers")
    link.write(b"refused")
    assert link.read() == []
    assert link.counters.errors > 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(address)
        again.settimeout(5)
        link.write(b"two")
        assert again.recv(99) == b"two"
        again.sendto(b"answer", link.sock.getsockname())
        assert ready(link)
        assert link.read() == [(0, b"answer")]
    link.close()


def test_links_count_chunks_and_bytes(server: UdpServer) -> None:
    client = UdpClient("127.0.0.1", server.port)
    client.write(b"12345")
    assert ready(server)
    server.read()
    assert (client.counters.chunks_out, client.counters.bytes_out) == (1, 5)
    assert (server.counters.chunks_in, server.counters.bytes_in) == (1, 5)
    client.close()


def test_datagrams_dropped_by_the_kernel_are_counted(
    server: UdpServer, sockets: list[socket.socket]
) -> None:
    server.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    for _ in range(100):
        sockets[0].sendto(bytes(1000), ("127.0.0.1", server.port))
    received = 0
    while chunks := server.read():
        received += len(chunks)
    assert server.lost_in_kernel == 100 - received > 0
