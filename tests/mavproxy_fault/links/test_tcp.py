import contextlib
import resource
import select
import selectors
import socket
from collections.abc import Callable, Iterator
from ipaddress import ip_address
from pathlib import Path

import pytest

from mavproxy_fault.links import stream, tcp
from mavproxy_fault.links.link import QUEUE_LIMIT, Chunk
from mavproxy_fault.links.peers import MAX_PEERS
from mavproxy_fault.links.stream import READ_SIZE
from mavproxy_fault.links.tcp import TcpClient, TcpServer

Link = TcpServer | TcpClient


@pytest.fixture
def server() -> Iterator[TcpServer]:
    link = TcpServer("127.0.0.1", 0)
    yield link
    link.close()


def read_until(link: Link, done: Callable[[list[Chunk]], bool]) -> list[Chunk]:
    """Serve a link by its descriptors until `done`."""
    chunks: list[Chunk] = []
    while not done(chunks):
        # Without a common descriptor, pending writes continue a few times per second.
        one_for_all = hasattr(selectors.DefaultSelector, "fileno")
        ready, _, _ = select.select(link.filenos(), [], [], 5 if one_for_all else 0.1)
        assert ready or not one_for_all, chunks
        chunks += link.read()
    return chunks


def connect(server: TcpServer) -> socket.socket:
    peer = socket.create_connection(("127.0.0.1", server.port), timeout=5)
    count = server.peer_count
    read_until(server, lambda _: server.peer_count > count)
    return peer


def test_a_server_distinguishes_its_peers_and_reports_their_end(server: TcpServer) -> None:
    with connect(server) as one, connect(server) as two:
        one.sendall(b"first")
        assert read_until(server, bool) == [(0, b"first")]
        two.sendall(b"second")
        assert read_until(server, bool) == [(1, b"second")]
        server.write(b"to all")
        assert one.recv(99) == two.recv(99) == b"to all"
    ends = read_until(server, lambda chunks: len(chunks) == 2)
    assert sorted(ends) == [(0, b""), (1, b"")]
    assert server.peer_count == 0


def test_a_server_accepts_a_limited_number_of_peers_and_rejects_more(server, caplog) -> None:
    with contextlib.ExitStack() as opened:
        peers = [opened.enter_context(connect(server)) for _ in range(MAX_PEERS)]
        late = [
            opened.enter_context(socket.create_connection(("127.0.0.1", server.port), timeout=5))
            for _ in range(2)
        ]
        read_until(server, lambda _: server.counters.errors == 2)
        assert [one.recv(9) for one in late] == [b"", b""]
        server.write(b"to all")
        assert {peer.recv(9) for peer in peers} == {b"to all"}
        assert caplog.text.count("another one was rejected") == 1
        peers[0].close()
        read_until(server, lambda _: server.peer_count < MAX_PEERS)
        opened.enter_context(connect(server))


def test_a_server_without_any_descriptor_sleeps_and_accepts_its_peer_later(
    server: TcpServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(tcp.time, "monotonic", lambda: now_s[0])
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with socket.create_connection(("127.0.0.1", server.port), timeout=5) as peer:
        # Below the number in use: the reserve closed for the peer cannot be reopened.
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
        try:
            for _ in range(3):
                server.read()
                assert not select.select(server.filenos(), (), (), 0)[0], "the loop spins"
                now_s[0] += tcp.ACCEPT_PAUSE_S
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        server.read()
        assert server.peer_count == 1
        server.write(b"word")
        assert peer.recv(9) == b"word"
    assert caplog.text.count("no descriptor for another peer") == 1


def test_a_peer_that_does_not_read_stalls_no_other_and_gets_complete_chunks(
    server: TcpServer,
) -> None:
    chunk = bytes(range(256)) * 64
    with connect(server) as slow, connect(server) as quick:
        sent = 0
        while server.counters.drops < 5:
            server.write(chunk)
            sent += 1
            got = b""
            while len(got) < len(chunk):
                got += quick.recv(len(chunk) - len(got))
            assert got == chunk
            assert sent * len(chunk) < 100 * QUEUE_LIMIT
        expected = (sent - 5) * len(chunk)
        received = bytearray()
        slow.settimeout(0.05)
        while len(received) < expected:
            with contextlib.suppress(TimeoutError):
                received += slow.recv(1 << 20)
            server.read()
    assert bytes(received) == chunk * (sent - 5)


def test_a_client_connects_when_its_server_appears(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "REOPEN_S", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    client = TcpClient("127.0.0.1", port)
    read_until(client, lambda _: client.counters.errors > 0)
    client.write(b"stale")
    assert client.counters.drops == 1
    with socket.create_server(("127.0.0.1", port)) as listener:
        listener.settimeout(5)
        while not client.peer_count:
            client.read()
        peer, _ = listener.accept()
        client.write(b"fresh")
        assert peer.recv(99) == b"fresh"
        peer.sendall(b"answer")
        assert read_until(client, bool) == [(0, b"answer")]
        peer.close()
        assert read_until(client, bool) == [(0, b"")]
        while not client.peer_count:
            client.read()
        again, _ = listener.accept()
        again.sendall(b"back")
        assert read_until(client, bool) == [(1, b"back")]
        again.close()
    client.close()


def test_a_client_reports_a_lost_connection_but_no_failed_attempt(server, caplog) -> None:
    client = TcpClient("127.0.0.1", server.port)
    read_until(server, lambda _: server.peer_count == 1)
    client.read()
    server.close()
    read_until(client, lambda _: client.counters.errors >= 1)
    client.close()
    messages = [record.message for record in caplog.records]
    assert messages == [f"tcp:127.0.0.1:{server.port}: the connection was lost; reconnecting"]


def test_a_client_that_the_system_connects_to_itself_tries_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    prepare = tcp._prepare

    def prepare_at_port(sock: socket.socket) -> None:
        """The port that the system sometimes chooses for a connection in its own range."""
        prepare(sock)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(("127.0.0.1", port))

    monkeypatch.setattr(tcp, "_prepare", prepare_at_port)
    client = TcpClient("127.0.0.1", port)
    client.write(b"never heard")
    try:
        assert read_until(client, lambda _: client.counters.errors > 0) == []
        assert client.peer_count == 0
        assert client.counters.drops == 1
        assert caplog.text == ""
    finally:
        client.close()


def test_a_client_without_a_descriptor_reports_it_once_and_connects_later(
    server: TcpServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(tcp.time, "monotonic", lambda: now_s[0])
    client = TcpClient("127.0.0.1", server.port)
    try:
        read_until(server, lambda _: server.peer_count == 1)
        read_until(client, lambda _: client.peer_count == 1)
        limits = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
        try:
            [(sock, _, _)] = server._peers.values()
            sock.shutdown(socket.SHUT_RDWR)
            read_until(client, lambda chunks: (0, b"") in chunks)
            for _ in range(3):
                now_s[0] += stream.REOPEN_S
                assert client.read() == []
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        assert caplog.text.count("no connection: [Errno 24]") == 1
        now_s[0] += stream.REOPEN_S
        client.read()
        read_until(client, lambda _: client.peer_count == 1)
    finally:
        client.close()


def test_either_side_detects_that_the_other_was_switched_off(server: TcpServer) -> None:
    client = TcpClient("127.0.0.1", server.port)
    try:
        read_until(server, lambda _: server.peer_count == 1)
        [(accepted, _, _)] = server._peers.values()
        for sock in (accepted, client._peer[0]):
            assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    finally:
        client.close()


def test_a_server_listens_at_an_address_that_needs_its_interface_named() -> None:
    table = Path("/proc/net/if_inet6")  # Linux' own: address, ..., scope (20: of one link), name
    rows = [line.split() for line in table.read_text().splitlines()] if table.exists() else []
    found = [(row[0], row[5]) for row in rows if row[3] == "20"]
    if not found:
        pytest.skip("no interface has an address of its own link")
    digits, interface = found[0]
    link = TcpServer(f"{ip_address(int(digits, 16))}%{interface}", 0)
    link.close()


def test_fast_peers_share_what_is_read_in_one_turn(server: TcpServer) -> None:
    with contextlib.ExitStack() as opened:
        peers = [opened.enter_context(connect(server)) for _ in range(8)]
        for peer in peers:
            peer.sendall(bytes(READ_SIZE // 2))
        while len(server._descriptors.ready()) < 8:
            pass
        turn = server.read()
        assert {number for number, _ in turn} == set(range(8))
        assert sum(len(data) for _, data in turn) <= READ_SIZE
        everything = 8 * (READ_SIZE // 2)
        read_until(server, lambda chunks: sum(len(data) for _, data in turn + chunks) == everything)


def test_a_server_reports_its_last_peer_leaving_but_not_a_port_check(server, caplog) -> None:
    connect(server).close()
    assert read_until(server, bool) == [(0, b"")]
    with connect(server) as peer:
        peer.sendall(b"word")
        assert read_until(server, bool) == [(1, b"word")]
    assert read_until(server, bool) == [(1, b"")]
    messages = [record.message for record in caplog.records]
    assert messages == [f"{server.name}: the last peer closed its connection; no peer is left"]


def test_what_is_written_while_connecting_arrives(server: TcpServer) -> None:
    client = TcpClient("127.0.0.1", server.port)
    client.write(b"at once")
    read_until(client, lambda _: client.peer_count == 1)
    assert read_until(server, bool) == [(0, b"at once")]
    client.close()


def test_a_fast_peer_does_not_starve_others() -> None:
    link = TcpServer("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", link.port)) as peer:
        peer.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                peer.send(bytes(1 << 20))
        link.read()
        assert 0 < sum(len(data) for _, data in link.read()) <= READ_SIZE
    link.close()


def test_a_single_busy_peer_does_not_keep_others_from_connecting(
    server: TcpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(tcp.time, "monotonic", lambda: now_s[0])
    with connect(server) as busy:
        busy.sendall(b"more")
        with socket.create_connection(("127.0.0.1", server.port), timeout=5):
            for _ in range(10):
                read_until(server, bool)
                busy.sendall(b"more")
                now_s[0] += 0.02
            assert server.peer_count == 2
