import ipaddress
import socket
import struct

from mavproxy_fault.links.peers import MAX_PEERS, PEER_EXPIRY_S, Admission, Peers

FRAME = b"a frame"


def address(host: str, port: int = 14550) -> bytes:
    return struct.pack("=H", socket.AF_INET) + struct.pack(">H", port) + socket.inet_aton(host)


def peers(*allowed: str, lock: bool = False) -> Peers:
    found = Peers()
    networks = tuple(ipaddress.ip_network(text) for text in allowed)
    found.admission = Admission(networks, lock, lambda data: data == FRAME)
    return found


def test_strangers_do_not_displace_a_silent_vehicle() -> None:
    it = peers()
    vehicle = address("10.0.0.1")
    it.register(vehicle, FRAME, 0.0)
    for n in range(2 * MAX_PEERS):
        it.register(address("10.0.1.1", n), b"x", 10 * PEER_EXPIRY_S + n)
    assert vehicle in it.by_address
    assert len(it.by_address) == MAX_PEERS


def test_a_proven_newcomer_displaces_the_unproven_first() -> None:
    it = peers()
    for n in range(MAX_PEERS):
        it.register(address("10.0.1.1", n), FRAME if n else b"x", 0.01 * n)
    it.register(address("10.0.0.1"), FRAME, 2.0)
    assert address("10.0.1.1", 0) not in it.by_address
    assert address("10.0.0.1") in it.by_address
    assert it.register(address("10.0.0.2"), b"x", 3.0)
    assert address("10.0.0.2") not in it.by_address


def test_only_allowed_addresses_are_heard() -> None:
    it = peers("10.0.0.0/24", "192.168.7.7")
    heard = [
        it.register(address(host), FRAME, 0.0) for host in ("10.0.0.9", "192.168.7.7", "10.0.1.1")
    ]
    assert heard == [True, True, False]
    assert set(it.by_address) == {address("10.0.0.9"), address("192.168.7.7")}


def test_a_locked_link_accepts_only_the_first_proven_peer() -> None:
    it = peers(lock=True)
    assert it.register(address("10.0.0.1"), b"x", 0.0)
    assert it.register(address("10.0.0.2"), FRAME, 0.1)
    assert not it.register(address("10.0.0.1"), FRAME, 0.2)
    assert not it.register(address("10.0.0.3"), FRAME, 1000.0)
    assert list(it.by_address) == [address("10.0.0.2")]
