"""Connections that a fault closes, resets or refuses, on a real proxy, and faults by endpoint."""

import socket
import time
from collections.abc import Callable
from typing import Any

import pytest

from mavproxy_fault.links.tcp import TcpClient, TcpServer
from mavproxy_fault.proxy.core import Core, LinkRole
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

WALL_US = 1_700_000_000_000_000
ROLES = (
    LinkRole("vehicle", "from-vehicle"),
    LinkRole("first", "to-vehicle"),
    LinkRole("second", "to-vehicle"),
)


def wait_for(happened: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 10
    while not happened():
        assert time.monotonic() < deadline_s


def connected(server: TcpServer) -> socket.socket:
    peer = socket.create_connection(("127.0.0.1", server.port), timeout=10)
    count = server.peer_count

    def accepted() -> bool:
        server.read()
        return server.peer_count > count

    wait_for(accepted)
    return peer


def ended(server: TcpServer) -> list[tuple[int, bytes]]:
    chunks: list[tuple[int, bytes]] = []

    def gone() -> bool:
        chunks.extend(server.read())
        return not server.peer_count

    wait_for(gone)
    return chunks


def test_a_closed_connection_ends_for_its_peer_and_for_the_core() -> None:
    server = TcpServer("127.0.0.1", 0)
    with connected(server) as peer:
        server.interrupt("closed")
        assert ended(server) == [(0, b"")]
        assert peer.recv(10) == b""
    server.close()


def test_a_reset_connection_fails_for_its_peer() -> None:
    server = TcpServer("127.0.0.1", 0)
    with connected(server) as peer:
        server.interrupt("reset")
        ended(server)
        with pytest.raises(ConnectionResetError):
            peer.recv(10)
    server.close()


def test_new_connections_are_refused_until_the_fault_ends() -> None:
    server = TcpServer("127.0.0.1", 0)
    with connected(server) as peer:
        server.interrupt("refused")
        ended(server)
        with pytest.raises(ConnectionResetError):
            peer.recv(10)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port), timeout=10)
    server.interrupt("refused")  # it is repeated
    server.interrupt("kept")
    connected(server).close()
    server.close()


def test_a_sliced_stream_arrives_in_pieces_and_in_order() -> None:
    server = TcpServer("127.0.0.1", 0)
    with connected(server) as peer:
        server.interrupt((7, 0, 0.0))
        assert server.lone_peer() is None  # machine code would write it whole
        server.write(bytes(range(20)))
        server.write(bytes(range(20, 30)))
        pieces = []
        while sum(map(len, pieces)) < 30:
            pieces.append(peer.recv(100))  # the next pieces leave at the next read
            server.read()
        assert len(pieces[0]) == 7
        assert len(pieces) > 2
        assert b"".join(pieces) == bytes(range(30))
        server.interrupt("kept")
        assert server.lone_peer() is not None
    server.close()


def test_pieces_vary_in_size_and_wait_for_their_pause() -> None:
    server = TcpServer("127.0.0.1", 0)
    with connected(server) as peer:
        peer.setblocking(False)
        server.interrupt((7, 3, 0.004))
        server.write(bytes(range(100)))
        sizes: list[int] = []
        begin_s = time.monotonic()
        while sum(sizes) < 100:
            server.flush()
            try:
                sizes.append(len(peer.recv(100)))
            except BlockingIOError:
                continue
    server.close()
    assert set(sizes) <= set(range(1, 11))
    assert len(set(sizes)) > 2
    assert time.monotonic() - begin_s >= 0.004 * (len(sizes) - 1)


def test_a_slice_is_labelled_and_leaves_frames_whole_in_the_recording() -> None:
    got, core = passed([{"fault": "slice", "value": 9, "at_s": 1, "where": {"endpoint": 1}}])
    assert got == [[], [0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5]]
    assert core.drain_labels()[-1].fault == "slice"
    engine: Any = core.engine
    assert engine.interrupted == {2: (9, 0, 0.0)}


def test_an_interrupted_client_connects_again_after_the_fault() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = TcpClient("127.0.0.1", listener.getsockname()[1])

        def read_until(count: int) -> None:
            def reached() -> bool:
                client.read()
                return client.peer_count == count

            wait_for(reached)

        with listener.accept()[0] as first:
            first.settimeout(10)
            read_until(1)
            client.interrupt("reset")
            read_until(0)
            with pytest.raises(ConnectionResetError):
                first.recv(10)
        client.interrupt("reset")  # which puts the next attempt off
        client._retry_s = 0.0
        client.interrupt("kept")
        read_until(1)
        client.close()


def passed(faults: list[dict[str, Any]], count: int = 6) -> tuple[list[list[int]], Core]:
    """Numbers of the frames that each endpoint gets, of those that the vehicle sends."""
    core = Core(ROLES, Engine(parse_schedule({"seed": 1, "faults": faults})))
    layout = message_layout("PARAM_VALUE")
    got: list[list[int]] = [[], [], []]
    for n in range(count):
        raw = build_frame(layout, {"param_index": n, "param_count": 100})
        for send in core.received(0, raw, WALL_US + n * 1_000_000):
            if send.data == raw:
                got[send.link].append(n)
    return got, core


def test_a_fault_of_one_endpoint_leaves_the_others_alone() -> None:
    outage = {"fault": "outage", "at_s": 2, "for_s": 2, "where": {"endpoint": 1}}
    got, core = passed([outage])
    assert got == [[], [0, 1, 4, 5], [0, 1, 2, 3, 4, 5]]
    label = core.drain_labels()[-1]
    assert (label.where, label.frames) == ({"endpoint": 1}, 2)
    # what comes from it is lost too
    request = build_frame(message_layout("PARAM_REQUEST_LIST"), {}, system=255)
    core = Core(ROLES, Engine(parse_schedule({"faults": [{**outage, "at_s": 0}]})))
    core.received(0, build_frame(message_layout("HEARTBEAT"), {}), WALL_US)
    assert [s for s in core.received(1, request, WALL_US + 1000) if s.data == request] == []
    assert [s.link for s in core.received(2, request, WALL_US + 2000) if s.data == request] == [0]


def test_the_link_switches_over_from_one_endpoint_to_the_other() -> None:
    got, _ = passed([
        {"id": "a", "fault": "outage", "at_s": 3, "where": {"endpoint": 1}},
        {"id": "b", "fault": "outage", "for_s": 4, "where": {"endpoint": 2}},
    ])  # fmt: skip
    assert got == [[], [0, 1, 2], [4, 5]]


def test_a_changed_value_goes_to_one_endpoint_only() -> None:
    entry = {"fault": "bias", "target": "PARAM_VALUE.param_count", "value": 7}
    core = Core(ROLES, Engine(parse_schedule({"faults": [{**entry, "where": {"endpoint": 2}}]})))
    raw = build_frame(message_layout("PARAM_VALUE"), {"param_count": 100})
    sends = {send.link: send.data for send in core.received(0, raw, WALL_US)[:2]}
    assert sends[1] == raw
    assert sends[2] == build_frame(message_layout("PARAM_VALUE"), {"param_count": 107})


def test_a_connection_is_interrupted_after_so_many_bytes() -> None:
    entry = {"fault": "outage", "after_bytes": 70, "connection": "reset"}
    core = Core(ROLES, Engine(parse_schedule({"faults": [{**entry, "where": {"endpoint": 1}}]})))
    raw = build_frame(message_layout("PARAM_VALUE"), {"param_index": 9, "param_type": 9})
    sizes = []
    for n in range(4):
        engine: Any = core.engine
        before = dict(engine.interrupted)
        sends = [s for s in core.received(0, raw, WALL_US + n) if s.link == 1 and s.data == raw]
        sizes.append((len(sends), before, dict(engine.interrupted)))
    assert len(raw) == 37
    assert [size for size, *_ in sizes] == [1, 0, 0, 0]
    assert [after for *_, after in sizes] == [{}, {2: "reset"}, {2: "reset"}, {2: "reset"}]
