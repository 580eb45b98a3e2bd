"""TCP links: a client that reconnects and a server for several peers.

Each link watches its changing set of sockets through its own `Descriptors`.
"""

import contextlib
import errno
import logging
import math
import socket
import struct
import time
from typing import Any

from mavproxy_fault.links.descriptors import Descriptors
from mavproxy_fault.links.link import Chunk, LinkCounters, host_port
from mavproxy_fault.links.peers import MAX_PEERS
from mavproxy_fault.links.stream import READ_SIZE, REOPEN_S, ReopenedLink, Stream, Treatment

LOG = logging.getLogger(__name__)
ACCEPT_PAUSE_S = 0.5  # without accepting connections after running out of descriptors
KEEPALIVE_IDLE_S = 60  # idle time before 3 probes at 10 s: a lost peer is found in 90 s
RECEIVE_BUFFER = 1 << 17  # bytes, 2,500 small frames: TCP throttles a fast sender early


def _prepare(sock: socket.socket) -> None:
    sock.setblocking(False)
    # Frames are small and urgent: Nagle would delay them until the next acknowledgement.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    # Keepalive detects a peer that vanished without closing.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", KEEPALIVE_IDLE_S),
        ("TCP_KEEPINTVL", 10),
        ("TCP_KEEPCNT", 3),
    ):
        if hasattr(socket, name):  # some systems have only the first, or none
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _is_self_connected(sock: socket.socket) -> bool:
    """Whether a client connected to itself: the port has no server and was also its own."""
    try:
        return bool(sock.getsockname() == sock.getpeername())
    except OSError:  # already lost again, which the next read detects
        return False


def _stream(sock: socket.socket, descriptors: Descriptors, counters: LinkCounters) -> Stream:
    return Stream(sock.fileno(), (sock.recv, sock.send), descriptors, counters, empty_is_end=True)


def _interrupt(sock: socket.socket, stream: Stream, how: Treatment) -> None:
    """End a connection, which the next read finds, or send in pieces.

    Closing a socket that does not linger sends a reset, unless it was shut down for writing.
    """
    stream.pieces = how if isinstance(how, tuple) else None
    with contextlib.suppress(OSError):  # already lost
        if how == "closed":
            sock.shutdown(socket.SHUT_RDWR)
        elif how in ("reset", "refused"):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            sock.shutdown(socket.SHUT_RD)


class TcpServer:
    """Accepts up to 32 peers and sends to all of them."""

    datagrams = False

    def __init__(self, host: str, port: int) -> None:
        info = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        self._family, address = info[0], info[4]
        self._descriptors = Descriptors()
        self._listen(address)
        self._address: Any = self._listener.getsockname()
        self.port: int = self._address[1]
        self.name = f"tcpin:{host_port(host, self.port)}"
        self.counters = LinkCounters()
        self._peers: dict[int, tuple[socket.socket, Stream, int]] = {}  # by descriptor
        self._next_stream = 0
        self._reserve = socket.socket()  # a descriptor to free when none are left
        self._warned = False
        self._accept_paused_until_s: float | None = None  # while the listener is not watched

    def _listen(self, address: Any) -> None:
        self._listener = socket.create_server(address, family=self._family, backlog=16)
        self._listener.setblocking(False)
        # Set before accepting: connections inherit the listener's window.
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._descriptors.add(self._listener.fileno())

    def interrupt(self, how: Treatment) -> None:
        """Treat connections as a fault asks, `kept` to go on; repeated while it is active."""
        refused = self._listener.fileno() < 0
        if how == "refused" and not refused:
            self._accept_paused_until_s = None
            with contextlib.suppress(OSError):  # not watched while accepting is paused
                self._descriptors.unregister(self._listener.fileno())
            self._listener.close()
        elif how != "refused" and refused:
            try:
                self._listen(self._address)
            except OSError as error:  # tried again at the next call
                self._warn_once(f"cannot listen again: {error}")
        for sock, stream, _ in self._peers.values():
            _interrupt(sock, stream, how)

    @property
    def peer_count(self) -> int:
        """Number of connected peers."""
        return len(self._peers)

    def filenos(self) -> list[int]:
        """Return the descriptors of the listener and all connections."""
        return self._descriptors.filenos()

    def lone_peer(self) -> tuple[int, int] | None:
        """Return descriptor and stream of the only peer, provided its queue is empty."""
        if len(self._peers) != 1:
            return None
        _, stream, number = next(iter(self._peers.values()))
        return None if stream.has_pending else (stream.fileno, number)

    def read(self) -> list[Chunk]:
        """Accept peers, continue pending writes, and return received data."""
        chunks: list[Chunk] = []
        now_s = time.monotonic()
        if self._accept_paused_until_s is not None and now_s >= self._accept_paused_until_s:
            self._accept_paused_until_s = None
            self._descriptors.add(self._listener.fileno())
        # Only ready descriptors: saves a system call for each of the others.
        ready = self._descriptors.ready()
        # Without shares, 32 flooding peers would delay a slow one for a second.
        share = READ_SIZE // max(len(ready), 1)
        for descriptor in ready:
            if descriptor == self._listener.fileno():
                self._accept()
            else:
                self._read_from(descriptor, share, chunks)
        return chunks

    def _read_from(self, descriptor: int, most: int, chunks: list[Chunk]) -> None:
        """Continue pending writes to a peer and append received data to `chunks`."""
        sock, stream, number = self._peers[descriptor]
        stream.flush()
        data, is_open = stream.read(most)
        if data:
            chunks.append((number, data))
        if not is_open:
            stream.abandon()
            sock.close()
            del self._peers[descriptor]
            self._warn_last_peer_left()
            # Empty bytes end the stream: its incomplete frame will not be completed.
            chunks.append((number, b""))

    def _warn_last_peer_left(self) -> None:
        # Warn if data had been received; a mere port check is not worth a message.
        if not self._peers and self.counters.bytes_in:
            LOG.warning("%s: the last peer closed its connection; no peer is left", self.name)

    def _accept(self) -> None:
        while True:
            try:
                sock, _ = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as error:
                if error.errno in (errno.EMFILE, errno.ENFILE):
                    self._reject_without_descriptor()
                else:
                    self.counters.errors += 1
                return
            if len(self._peers) >= MAX_PEERS:
                # Each frame is sent to each peer: a thousand would saturate the loop.
                sock.close()
                self._count_rejected(f"{MAX_PEERS} peers are connected; another one was rejected")
                continue
            _prepare(sock)
            stream = _stream(sock, self._descriptors, self.counters)
            self._peers[sock.fileno()] = (sock, stream, self._next_stream)
            self._next_stream += 1

    def _reject_without_descriptor(self) -> None:
        """Accept and close a connection with the reserve descriptor, as none is left for it."""
        # A connection left waiting would wake the loop continuously.
        why = "no descriptor for another peer; raise the limit (ulimit -n)"
        self._reserve.close()
        try:
            self._listener.accept()[0].close()
        except BlockingIOError:  # no connection waits: Linux checks descriptors first
            pass
        except OSError:  # another thread took the descriptor, or the limit was lowered
            self._descriptors.unregister(self._listener.fileno())
            self._accept_paused_until_s = time.monotonic() + ACCEPT_PAUSE_S
            self._warn_once(why)
        else:
            self._count_rejected(why)
        with contextlib.suppress(OSError):  # none available: retried at the next rejection
            self._reserve = socket.socket()

    def _count_rejected(self, why: str) -> None:
        """Count a rejected connection and warn of the first."""
        self.counters.errors += 1
        self._warn_once(why)

    def _warn_once(self, why: str) -> None:
        """Log once why a connection was rejected."""
        if not self._warned:
            LOG.warning("%s: %s", self.name, why)
            self._warned = True

    def write(self, data: bytes) -> None:
        """Send to every peer; the chunk is dropped if there is none."""
        if not self._peers:
            self.counters.drops += 1
        for _, stream, _ in self._peers.values():
            stream.write(data)

    def flush(self) -> float:
        """Send what pauses have kept; return when the first of the next ones ends [s]."""
        return min((stream.flush() for _, stream, _ in self._peers.values()), default=math.inf)

    def close(self) -> None:
        """Close the listener and all connections."""
        for sock, stream, _ in self._peers.values():
            stream.abandon()
            sock.close()
        self._peers.clear()
        self._listener.close()
        self._reserve.close()
        self._descriptors.close()


class TcpClient(ReopenedLink):
    """Connects to a server and reconnects whenever the connection is lost."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp:{host_port(host, port)}")
        address_info = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._family = address_info[0]
        self._address = address_info[4]
        self._warned = False
        self._reopen()

    def interrupt(self, how: Treatment) -> None:
        """Treat the connection as a fault asks, `kept` to go on; repeated while it is active."""
        if self._peer is not None:
            _interrupt(*self._peer, how)
        if how in ("closed", "reset", "refused"):
            self._retry_s = time.monotonic() + REOPEN_S

    def _open(self) -> tuple[socket.socket, Stream]:
        try:
            sock = socket.socket(self._family, socket.SOCK_STREAM)
        except OSError as error:  # no descriptors: retried at the next attempt
            self.counters.errors += 1
            if not self._warned:
                LOG.warning("%s: no connection: %s", self.name, error)
                self._warned = True
            raise
        _prepare(sock)
        # Non-blocking: the descriptor becomes ready when the connection succeeds or fails.
        sock.connect_ex(self._address)
        stream = _stream(sock, self._descriptors, self.counters)
        stream.await_open()
        return sock, stream

    def _is_open(self, sock: socket.socket, stream: Stream) -> bool:
        if stream.open or not self._descriptors.ready():
            return stream.open
        # A failed connection is also writable; only SO_ERROR distinguishes them.
        if sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) or _is_self_connected(sock):
            self._lose()
            return False
        stream.open = True
        return True

    def _lose(self) -> None:
        # Warn of a lost connection, but not of attempts to reach a missing server.
        if self.peer_count:
            LOG.warning("%s: the connection was lost; reconnecting", self.name)
        super()._lose()


OPENERS = {"tcp": TcpClient, "tcpin": TcpServer}
