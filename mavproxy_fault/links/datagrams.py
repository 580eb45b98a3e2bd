"""Datagrams of one socket; on Linux the compiled path receives and sends them.

Addresses have the raw Linux form on every system, so that their users (`peers`, the compiled path)
need only one form.
"""

import socket
import struct
import sys

# Whether the compiled path's system calls are there.
IS_LINUX = sys.platform == "linux" and hasattr(socket, "MSG_DONTWAIT")
BATCH = 64
MAX_DATAGRAM = 65_536  # a shorter buffer would truncate silently
V4, V6 = struct.Struct("=H2s4s8x"), struct.Struct("=H2s4s16sI")  # sockaddr_in, sockaddr_in6


def receive_datagrams(sock: socket.socket) -> list[tuple[bytes, bytes]]:
    """Return raw address and bytes of a socket's waiting datagrams, at most 64."""
    datagrams: list[tuple[bytes, bytes]] = []
    while len(datagrams) < BATCH:
        try:
            data, address = sock.recvfrom(MAX_DATAGRAM)
        except OSError:  # no datagram waits, or an earlier one that we sent was refused
            break
        datagrams.append((_raw(address), data))
    return datagrams


def send_datagram(sock: socket.socket, data: bytes, address: bytes | None = None) -> bool:
    """Send one datagram; return False if the kernel did not accept it."""
    try:
        if address is None:
            sock.send(data)
        else:
            sock.sendto(data, _pair(address))
    except OSError:
        return False
    return True


def _raw(address: tuple[str, int] | tuple[str, int, int, int]) -> bytes:
    """Convert Python's address to Linux's raw form; port and host are in network byte order."""
    port = address[1].to_bytes(2, "big")
    if len(address) == 2:
        return V4.pack(socket.AF_INET, port, socket.inet_aton(address[0]))
    host = socket.inet_pton(socket.AF_INET6, address[0].partition("%")[0])
    flow = address[2].to_bytes(4, "big")
    return V6.pack(socket.AF_INET6, port, flow, host, address[3])


def _pair(raw: bytes) -> tuple[str, int] | tuple[str, int, int, int]:
    """Convert a raw address to the form of Python's sockets."""
    port = int.from_bytes(raw[2:4], "big")
    if len(raw) == V4.size:
        return socket.inet_ntoa(raw[4:8]), port
    _, _, flow, host, scope = V6.unpack(raw)
    return socket.inet_ntop(socket.AF_INET6, host), port, int.from_bytes(flow, "big"), scope
