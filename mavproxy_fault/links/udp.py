"""UDP links: a server that sends to every peer heard, and a client of one address."""

import socket
import struct
import time

from mavproxy_fault.links.datagrams import receive_datagrams, send_datagram
from mavproxy_fault.links.link import Chunk, LinkCounters, enlarge_buffers, host_port
from mavproxy_fault.links.peers import Peers

SO_MEMINFO, DROPPED = 55, 8  # Linux <asm-generic/socket.h>; nine words, the last counts drops


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
        return lost_in_kernel(self.sock)

    def filenos(self) -> list[int]:
        """The socket's descriptor."""
        return [self.sock.fileno()]

    def register(self, address: bytes, data: bytes, now_s: float | None = None) -> bool:
        """Record that an address sent a datagram; return whether it is admitted."""
        return True

    def read(self) -> list[Chunk]:
        """Return waiting datagrams."""
        chunks: list[Chunk] = []
        counters = self.counters
        now_s = time.monotonic()
        for address, data in receive_datagrams(self.sock):
            counters.chunks_in += 1
            counters.bytes_in += len(data)
            if not self.register(address, data, now_s):
                counters.refused += 1
            # UDP allows empty datagrams, but empty bytes would mean the end of a stream.
            elif data:
                chunks.append((0, data))
        return chunks

    def _send(self, data: bytes, address: bytes | None = None) -> None:
        """Send and count; a refusal refers to an earlier datagram, and reporting clears it."""
        counters = self.counters
        if not send_datagram(self.sock, data, address):
            # The kernel reported the refusal of an earlier datagram: try again.
            counters.errors += 1
            if not send_datagram(self.sock, data, address):
                counters.drops += 1
                return
        counters.chunks_out += 1
        counters.bytes_out += len(data)

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

    def register(self, address: bytes, data: bytes, now_s: float | None = None) -> bool:
        """Record that an address sent a datagram, which makes it a peer if it is admitted."""
        return self.peers.register(address, data, time.monotonic() if now_s is None else now_s)

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

    def write(self, data: bytes) -> None:
        """Send one datagram."""
        self._send(data)


def lost_in_kernel(sock: socket.socket) -> int:
    """Return the kernel's drop count of a socket; 0 on systems that do not report it."""
    try:
        meminfo = struct.unpack("9I", sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 36))
    except (OSError, struct.error):
        return 0
    return int(meminfo[DROPPED])


OPENERS = {"udpin": UdpServer, "udpout": UdpClient}
