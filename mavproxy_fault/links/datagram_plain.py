"""Datagrams one by one, by Python's own sockets: for systems without Linux' calls.

Addresses are the raw ones of `datagram_batch`, whatever the system's own form is, so that all that
knows them (`peers`, the compiled form) knows one form.
"""

import socket
import struct

BATCH = 64
MAX_DATAGRAM = 65_536  # a shorter buffer would cut a datagram without a word
V4, V6 = struct.Struct("=H2s4s8x"), struct.Struct("=H2s4s16sI")  # sockaddr_in, sockaddr_in6


class PlainDatagrams:
    """One non-blocking socket."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    def receive(self) -> list[tuple[bytes, bytes]]:
        """The raw addresses and bytes of datagrams that wait, at most 64."""
        found: list[tuple[bytes, bytes]] = []
        while len(found) < BATCH:
            try:
                data, address = self._sock.recvfrom(MAX_DATAGRAM)
            except OSError:  # nothing waits, or an earlier datagram of ours was refused
                break
            found.append((_raw(address), data))
        return found

    def send(self, data: bytes, address: bytes | None = None) -> bool:
        """Send one datagram; False if the kernel did not take it."""
        try:
            if address is None:
                self._sock.send(data)
            else:
                self._sock.sendto(data, _pair(address))
        except OSError:
            return False
        return True


def _raw(address: tuple[str, int] | tuple[str, int, int, int]) -> bytes:
    """Python's address as Linux writes it; port and host are in the network's order."""
    port = address[1].to_bytes(2, "big")
    if len(address) == 2:
        return V4.pack(socket.AF_INET, port, socket.inet_aton(address[0]))
    host = socket.inet_pton(socket.AF_INET6, address[0].partition("%")[0])
    flow = address[2].to_bytes(4, "big")
    return V6.pack(socket.AF_INET6, port, flow, host, address[3])


def _pair(raw: bytes) -> tuple[str, int] | tuple[str, int, int, int]:
    """A raw address as Python's sockets want it."""
    port = int.from_bytes(raw[2:4], "big")
    if len(raw) == V4.size:
        return socket.inet_ntoa(raw[4:8]), port
    _, _, flow, host, scope = V6.unpack(raw)
    return socket.inet_ntop(socket.AF_INET6, host), port, int.from_bytes(flow, "big"), scope
