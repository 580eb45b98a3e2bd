"""UDP links: a server that sends to every peer heard, and a client of one address.

Addresses have the raw Linux form on every system, so that their users (`peers`, the compiled path)
need only one form.
"""

import socket
import struct
import sys
import time
from collections.abc import Iterator

from mavproxy_fault.links.link import Chunk, LinkCounters, enlarge_buffers, host_port
from mavproxy_fault.links.peers import Peers

# Whether the compiled path's system calls are there.
IS_LINUX = sys.platform == "linux" and hasattr(socket, "MSG_DONTWAIT")
BATCH = 64
MAX_DATAGRAM = 65_536  # a shorter buffer would truncate silently
V4, V6 = struct.Struct("=H2s4s8x"), struct.Struct("=H2s4s16sI")  # sockaddr_in, sockaddr_in6
SO_MEMINFO, DROPPED = 55, 8  # Linux <asm-generic/socket.h>; nine words, the last counts drops
MEMINFO = struct.Struct("9I")


def _open(host: str, port: int, *, listen: bool) -> socket.socket:
    flags = socket.AI_PASSIVE if listen else 0
    family, kind, protocol, _, address = socket.getaddrinfo(
        host, port, type=socket.SOCK_DGRAM, flags=flags
    )[0]
    sock = socket.socket(family, kind, protocol)
    sock.setblocking(False)
    enlarge_buffers(sock)
    try:
        if listen:
            sock.bind(address)
        else:
            sock.connect(address)
    except OSError:
        sock.close()
        raise
    return sock


class _UdpSocket:
    """A non-blocking socket and its counters, shared by server and client."""

    datagrams = True

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        self.sock = _open(host, port, listen=listen)
        self.counters = LinkCounters()

    @property
    def lost_in_kernel(self) -> int:
        """Datagrams dropped because the kernel's receive buffer was full."""
        try:
            meminfo = self.sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
            return int(MEMINFO.unpack(meminfo)[DROPPED])
        except (OSError, struct.error):  # a system that does not report it
            return 0

    def filenos(self) -> list[int]:
        """The socket's descriptor."""
        return [self.sock.fileno()]

    def _receive(self) -> Iterator[tuple[bytes, bytes]]:
        """Yield and count the raw address and the bytes of at most 64 waiting datagrams."""
        for _ in range(BATCH):
            try:
                data, address = self.sock.recvfrom(MAX_DATAGRAM)
            except OSError:  # no datagram waits, or an earlier one that we sent was refused
                return
            self.counters.chunks_in += 1
            self.counters.bytes_in += len(data)
            yield _raw(address), data

    def _send(self, data: bytes, address: bytes | None = None) -> None:
        """Send and count; a refusal refers to an earlier datagram: then it is tried again."""
        for last in (False, True):
            try:
                if address is None:
                    self.sock.send(data)
                else:
                    self.sock.sendto(data, _pair(address))
            except OSError:
                self.counters.drops += last
                self.counters.errors += not last
                continue
            self.counters.chunks_out += 1
            self.counters.bytes_out += len(data)
            return

    def close(self) -> None:
        """Close the socket."""
        self.sock.close()


class UdpServer(_UdpSocket):
    """Listens on an address and sends to every recently heard peer."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, listen=True)
        self.port: int = self.sock.getsockname()[1]
        self.name = f"udpin:{host_port(host, self.port)}"
        self.peers = Peers()

    @property
    def peer_count(self) -> int:
        """Number of peers."""
        return len(self.peers.by_address)

    def read(self) -> list[Chunk]:
        """Return waiting datagrams; their senders become peers."""
        chunks: list[Chunk] = []
        now_s = time.monotonic()
        for address, data in self._receive():
            if not self.peers.register(address, data, now_s):
                self.counters.refused += 1
            # UDP allows empty datagrams, but empty bytes would mean the end of a stream.
            elif data:
                chunks.append((0, data))
        return chunks

    def write(self, data: bytes) -> None:
        """Send a datagram to every peer; it is dropped if there is none."""
        if not self.peers.by_address:
            self.counters.drops += 1
        for address in self.peers.by_address:
            self._send(data, address)


class UdpClient(_UdpSocket):
    """Sends to one address and receives only from it; the peer may come and go."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, listen=False)
        self.name = f"udpout:{host_port(host, port)}"
        self.peer_count = 1  # UDP cannot know whether the address has a listener

    def read(self) -> list[Chunk]:
        """Return waiting datagrams."""
        return [(0, data) for _, data in self._receive() if data]

    def write(self, data: bytes) -> None:
        """Send one datagram."""
        self._send(data)


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


OPENERS = {"udpin": UdpServer, "udpout": UdpClient}
