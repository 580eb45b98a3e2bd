"""Peers of a listening UDP link: the recently heard, admitted addresses that it sends to.

A peer is proven once it has sent a verified frame. Unproven peers never displace proven ones, so
strangers cannot cut off a vehicle that is silent for a while.
"""

import ipaddress
import socket
from collections.abc import Callable
from dataclasses import dataclass

PEER_EXPIRY_S = 60.0  # a peer silent this long may be replaced, unless it was heard last
MAX_PEERS = 32  # chosen: every frame goes to every peer, so this bounds the cost of a frame

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


@dataclass(frozen=True, slots=True)
class Admission:
    """The rule for which addresses may be peers.

    `allowed` are networks (empty: every address). With `lock` only the first proven peer is
    accepted. `is_frame` decides whether a datagram proves its sender.
    """

    allowed: tuple[Network, ...] = ()
    lock: bool = False
    is_frame: Callable[[bytes], bool] = lambda _: False  # nothing proves a sender


@dataclass(slots=True)
class Peer:
    """When an address was last heard (monotonic seconds), and whether it is proven."""

    last_heard_s: float
    proven: bool = False


class Peers:
    """The peers of one link, by raw socket address."""

    def __init__(self) -> None:
        self.admission = Admission()
        self.by_address: dict[bytes, Peer] = {}
        self._last_heard = b""

    def register(self, address: bytes, data: bytes, now_s: float) -> bool:
        """Record that an address sent a datagram; return whether it is admitted."""
        peer = self.by_address.get(address)
        proven = peer is not None and peer.proven
        if not proven and not self._admits(address):
            return False
        # Checked only until proven: parsing every datagram would be too slow.
        proven = proven or self.admission.is_frame(data)
        if peer is None:
            if not self._make_room(proven, now_s):
                return True  # accepted, but nothing is sent back
            peer = self.by_address[address] = Peer(now_s)
        peer.last_heard_s, peer.proven = now_s, proven
        self._last_heard = address
        # Drop all unproven peers heard before.
        if proven and self.admission.lock:
            self.by_address = {address: peer}
        return True

    def confirm(self, address: bytes, now_s: float) -> None:
        """Record that a peer sent verified frames."""
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
        """Remove peers that a newcomer may displace; return whether there is a free place."""
        # A proven newcomer may displace any peer, an unproven one only unproven peers.
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
    """Return the host of a raw `sockaddr_in` or `sockaddr_in6`."""
    # The family is in host byte order, unlike port and address.
    family = int.from_bytes(address[:2], "little")
    if family == socket.AF_INET:
        return ipaddress.IPv4Address(address[4:8])
    host = ipaddress.IPv6Address(address[8:24])
    # A dual-stack socket reports IPv4 hosts as ::ffff:a.b.c.d; the user writes a.b.c.d.
    return host.ipv4_mapped or host
