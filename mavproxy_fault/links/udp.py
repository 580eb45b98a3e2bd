"""UDP: a server that answers everyone it has heard, and a client that sends to one address."""

import socket
import struct
import time

from mavproxy_fault.links import datagram_batch
from mavproxy_fault.links.datagram_plain import PlainDatagrams
from mavproxy_fault.links.link import Chunk, LinkCounters, enlarge_buffers, host_port
from mavproxy_fault.links.peers import Peers

SO_MEMINFO, DROPPED = 55, 8  # Linux <asm-generic/socket.h>; nine words, the last counts losses


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
    """What server and client share: a socket that never blocks, and its counters."""

    datagrams = True

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        self.sock = _open(host, port, listen=listen)
        self.counters = LinkCounters()
        batched = datagram_batch.HAS_RECVMMSG
        kind = datagram_batch.BatchedDatagrams if batched else PlainDatagrams
        self._datagrams = kind(self.sock)

    @property
    def lost_in_kernel(self) -> int:
        """Datagrams that came while the kernel's buffer was full."""
        return lost_in_kernel(self.sock)

    def filenos(self) -> list[int]:
        """The socket's descriptor."""
        return [self.sock.fileno()]

    def _send(self, data: bytes, address: bytes | None = None) -> None:
        """Send and count; a refusal belongs to an earlier datagram and is cleared by telling."""
        counters = self.counters
        if not self._datagrams.send(data, address):
            # The kernel reports that an earlier datagram was refused at the next call: once more.
            counters.errors += 1
            if not self._datagrams.send(data, address):
                counters.drops += 1
                return
        counters.chunks_out += 1
        counters.bytes_out += len(data)

    def close(self) -> None:
        """Close the socket."""
        self.sock.close()


class UdpServer(_UdpSocket):
    """Listens on an address; what is written goes to every peer heard of late."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, listen=True)
        self.port: int = self.sock.getsockname()[1]
        self.name = f"udpin:{host_port(host, self.port)}"
        self.peers = Peers()

    @property
    def peer_count(self) -> int:
        """How many peers are written to."""
        return len(self.peers.by_address)

    def read(self) -> list[Chunk]:
        """The datagrams that wait; their senders become peers."""
        chunks: list[Chunk] = []
        counters = self.counters
        now_s = time.monotonic()
        for address, data in self._datagrams.receive():
            counters.chunks_in += 1
            counters.bytes_in += len(data)
            if not self.register(address, data, now_s):
                counters.refused += 1
            # UDP allows empty datagrams, but empty bytes tell the reader that a stream has ended.
            elif data:
                chunks.append((0, data))
        return chunks

    def register(self, address: bytes, data: bytes, now_s: float | None = None) -> bool:
        """Note that an address spoke; whether it may be listened to."""
        return self.peers.register(address, data, time.monotonic() if now_s is None else now_s)

    def write(self, data: bytes) -> None:
        """Send a datagram to every peer; without peers it is dropped."""
        if not self.peers.by_address:
            self.counters.drops += 1
        for address in self.peers.by_address:
            self._send(data, address)


class UdpClient(_UdpSocket):
    """Sends to one address and hears only that one; the peer may come and go."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, listen=False)
        self.name = f"udpout:{host_port(host, port)}"
        self.peer_count = 1  # whether anybody listens there cannot be known

    def read(self) -> list[Chunk]:
        """The datagrams that wait."""
        chunks: list[Chunk] = []
        counters = self.counters
        for _, data in self._datagrams.receive():
            counters.chunks_in += 1
            counters.bytes_in += len(data)
            if data:
                chunks.append((0, data))
        return chunks

    def write(self, data: bytes) -> None:
        """Send one datagram."""
        self._send(data)


def lost_in_kernel(sock: socket.socket) -> int:
    """What the kernel has dropped on a socket since it was opened; 0 where it does not say."""
    try:
        words = struct.unpack("9I", sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 36))
    except (OSError, struct.error):
        return 0
    return int(words[DROPPED])


OPENERS = {"udpin": UdpServer, "udpout": UdpClient}
