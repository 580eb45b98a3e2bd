"""Who a listening UDP link answers: the addresses heard of late, within what was allowed.

A peer is proven once it has sent a verified frame. Those that are not never displace those that
are, so that strangers cannot cut off a vehicle that is silent for a while.
"""

import ipaddress
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass

PEER_EXPIRY_S = 60.0  # a silent peer makes room for a newcomer, unless it was the last to speak
MAX_PEERS = 32

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


def reject_every_datagram(_: bytes) -> bool:
    """What a link believes that was given no way to tell."""
    return False


@dataclass(frozen=True, slots=True)
class Admission:
    """Which addresses may be peers.

    `allowed` are networks (none: every address). With `lock` nobody is heard any more but the first
    peer that was proven. `is_frame` tells whether a datagram proves its sender.
    """

    allowed: tuple[Network, ...] = ()
    lock: bool = False
    is_frame: Callable[[bytes], bool] = reject_every_datagram


@dataclass(slots=True)
class Peer:
    """When an address last spoke (monotonic seconds), and whether it is proven."""

    last_heard_s: float
    proven: bool = False


class Peers:
    """The peers of one link by raw socket address."""

    def __init__(self) -> None:
        self.admission = Admission()
        self.by_address: dict[bytes, Peer] = {}
        self._last_heard = b""

    def register(self, address: bytes, data: bytes, now_s: float) -> bool:
        """Note that an address spoke; whether it may be listened to."""
        peer = self.by_address.get(address)
        proven = peer is not None and peer.proven
        if not proven and not self._admits(address):
            return False
        # Looked at only until it holds: parsing every datagram would cost the link its rate.
        proven = proven or self.admission.is_frame(data)
        if peer is None:
            if not self._make_room(proven, now_s):
                return True  # heard, but not answered
            peer = self.by_address[address] = Peer(now_s)
        peer.last_heard_s, peer.proven = now_s, proven
        self._last_heard = address
        # Whoever was heard before, unproven, is a stranger now.
        if proven and self.admission.lock:
            self.by_address = {address: peer}
        return True

    def confirm(self, address: bytes, now_s: float) -> None:
        """Note that a peer sent verified frames."""
        peer = self.by_address.get(address)
        if peer is not None:
            peer.last_heard_s, peer.proven = now_s, True
            self._last_heard = address

    def _admits(self, address: bytes) -> bool:
        if self.admission.lock and any(peer.proven for peer in self.by_address.values()):
            return False
        allowed = self.admission.allowed
        return not allowed or any(host_address(address) in network for network in allowed)

    def _make_room(self, proven: bool, now_s: float) -> bool:
        """Forget whom a newcomer may displace; whether there is room for it."""
        # A proven newcomer may displace anybody, an unproven one only its like.
        weaker = {a: peer for a, peer in self.by_address.items() if proven or not peer.proven}
        for address, peer in weaker.items():
            if now_s - peer.last_heard_s > PEER_EXPIRY_S and address != self._last_heard:
                del self.by_address[address]
        if len(self.by_address) < MAX_PEERS:
            return True
        remaining = [address for address in weaker if address in self.by_address]
        if not remaining:
            return False
        del self.by_address[
            min(remaining, key=lambda one: (weaker[one].proven, weaker[one].last_heard_s))
        ]
        return True


def host_address(address: bytes) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """The host of a raw `sockaddr_in` or `sockaddr_in6`."""
    # In the machine's own order, unlike the port and the host.
    family = int.from_bytes(address[:2], "little")
    if family == socket.AF_INET:
        return ipaddress.IPv4Address(address[4:8])
    found = ipaddress.IPv6Address(address[8:24])
    # A socket for both families shows IPv4 hosts as ::ffff:a.b.c.d; the user writes a.b.c.d.
    return found.ipv4_mapped or found


def parse_networks(texts: Sequence[str]) -> tuple[Network, ...]:
    """Networks by their text, such as 10.0.0.7 or 192.168.1.0/24.

    Raises
    ------
    ValueError
        If one is no network.
    """
    return tuple(ipaddress.ip_network(text) for text in texts)
