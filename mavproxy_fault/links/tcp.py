"""TCP: a client that reconnects and a server for several peers.

Each link has descriptors of its own over its sockets, which come and go.
"""

import contextlib
import errno
import logging
import socket
import time
from collections.abc import Sequence

from mavproxy_fault.links.descriptors import Descriptors
from mavproxy_fault.links.link import Chunk, LinkCounters, host_port
from mavproxy_fault.links.peers import MAX_PEERS
from mavproxy_fault.links.stream import READ_SIZE, Stream

LOG = logging.getLogger(__name__)
RECONNECT_S = 0.5
ACCEPT_CHECK_S = (
    0.1  # for which a lone peer that speaks all the time keeps others waiting at the door
)
ACCEPT_PAUSE_S = 0.5  # for which nobody is let in where there are no descriptors at all
KEEPALIVE_IDLE_S = 60  # after which a connection is asked whether the other side still lives
MAX_JOINED_BYTES = 1 << 16  # bytes at most that are kept, or dropped, as a whole
RECEIVE_BUFFER = 1 << 17  # bytes, 2,500 small frames: a fast peer waits rather than its frames


def _prepare(sock: socket.socket) -> None:
    sock.setblocking(False)
    # Frames are small and wanted now: Nagle would hold them back for the next acknowledgement.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    # The system finds out that a peer is gone that never said so.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", KEEPALIVE_IDLE_S),
        ("TCP_KEEPINTVL", 10),
        ("TCP_KEEPCNT", 3),
    ):
        if hasattr(socket, name):  # some systems know only the first, or none
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _is_self_connected(sock: socket.socket) -> bool:
    """Whether a port was called that nobody serves and that the system chose for the caller."""
    try:
        return bool(sock.getsockname() == sock.getpeername())
    except OSError:  # lost again already: the next read notices
        return False


def _stream(sock: socket.socket, descriptors: Descriptors, counters: LinkCounters) -> Stream:
    return Stream(sock.fileno(), (sock.recv, sock.send), descriptors, counters, empty_is_end=True)


class TcpServer:
    """Accepts up to MOST_PEERS peers; what is written goes to all of them."""

    datagrams = False

    def __init__(self, host: str, port: int) -> None:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        self._listener = socket.create_server(address, family=family, backlog=16)
        self._listener.setblocking(False)
        # Before connections come: the window of a connection is that of its listener.
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self.port: int = self._listener.getsockname()[1]
        self.name = f"tcpin:{host_port(host, self.port)}"
        self.counters = LinkCounters()
        self._peers: dict[int, tuple[socket.socket, Stream, int]] = {}  # by descriptor
        self._next_stream = 0
        self._accept_checked_s = 0.0  # when others than a lone peer were last asked for
        self._reserve = socket.socket()  # kept for the moment when there are no descriptors
        self._warned = False
        self._accept_paused_until_s: float | None = None  # the listener, unwatched so long
        self._descriptors = Descriptors()
        self._descriptors.add(self._listener.fileno())

    @property
    def peer_count(self) -> int:
        """How many peers are connected."""
        return len(self._peers)

    def filenos(self) -> list[int]:
        """What to wait on for the listener and all connections."""
        return self._descriptors.filenos()

    def lone_peer(self) -> tuple[int, int] | None:
        """Descriptor and stream of the only peer, where all that was written has left."""
        if len(self._peers) != 1:
            return None
        _, stream, number = next(iter(self._peers.values()))
        return None if stream.has_pending else (stream.fileno, number)

    def read(self) -> list[Chunk]:
        """Accept, continue pending writes, and collect what the peers sent."""
        chunks: list[Chunk] = []
        now_s = time.monotonic()
        if len(self._peers) == 1 and now_s - self._accept_checked_s < ACCEPT_CHECK_S:
            # Nobody else to be asked for: one system call, not two.
            self._read_from(next(iter(self._peers)), READ_SIZE, chunks)
            if chunks:
                return chunks
        self._accept_checked_s = now_s
        if self._accept_paused_until_s is not None and now_s >= self._accept_paused_until_s:
            self._accept_paused_until_s = None
            self._descriptors.add(self._listener.fileno())
        # Only those with something to do: a system call for each of the others is saved.
        ready = self._descriptors.ready()
        # Or 32 that send as fast as they can would keep one that does not waiting for a second.
        share = READ_SIZE // max(len(ready), 1)
        for descriptor in ready:
            if descriptor == self._listener.fileno():
                self._accept()
            else:
                self._read_from(descriptor, share, chunks)
        return chunks

    def _read_from(self, descriptor: int, most: int, chunks: list[Chunk]) -> None:
        """Carry on writing to a peer, and collect what it sent."""
        sock, stream, number = self._peers[descriptor]
        stream.flush()
        data, stands = stream.read(most)
        if data:
            chunks.append((number, data))
        if not stands:
            stream.abandon()
            sock.close()
            del self._peers[descriptor]
            self._warn_last_peer_left()
            # Empty bytes end the stream: its half frame will never be completed.
            chunks.append((number, b""))

    def _warn_last_peer_left(self) -> None:
        # Whoever flies should know; somebody who only looked whether the port is open is not told.
        if not self._peers and self.counters.bytes_in:
            LOG.warning("%s: the other side closed the connection; nobody is left", self.name)

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
                # Each frame goes to each of them: a thousand would take the loop's time for good.
                sock.close()
                self._count_rejected(
                    f"{MAX_PEERS} peers are connected; a further one is turned away"
                )
                continue
            _prepare(sock)
            stream = _stream(sock, self._descriptors, self.counters)
            self._peers[sock.fileno()] = (sock, stream, self._next_stream)
            self._next_stream += 1

    def _reject_without_descriptor(self) -> None:
        """Close a connection for which there is no descriptor, in the place of the reserve."""
        # Left waiting it would wake the loop for ever.
        why = "no descriptor for a further peer; allow more (ulimit -n)"
        self._reserve.close()
        try:
            self._listener.accept()[0].close()
        except BlockingIOError:  # nobody waits: Linux looks for a descriptor first
            pass
        except OSError:  # its place went to another thread, or the limit was lowered
            self._descriptors.remove(self._listener.fileno())
            self._accept_paused_until_s = time.monotonic() + ACCEPT_PAUSE_S
            self._warn_once(why)
        else:
            self._count_rejected(why)
        with contextlib.suppress(OSError):  # none to be had: the next one waits
            self._reserve = socket.socket()

    def _count_rejected(self, why: str) -> None:
        """Count a connection that was closed at once, and tell the first."""
        self.counters.errors += 1
        self._warn_once(why)

    def _warn_once(self, why: str) -> None:
        """Say once why somebody was not let in."""
        if not self._warned:
            LOG.warning("%s: %s", self.name, why)
            self._warned = True

    def write(self, data: bytes) -> None:
        """Send to every peer; without peers the chunk is dropped."""
        if not self._peers:
            self.counters.drops += 1
        for _, stream, _ in self._peers.values():
            stream.write(data)

    def write_all(self, chunks: Sequence[bytes]) -> None:
        """Send several chunks to every peer, with one system call for each peer."""
        data = b"".join(chunks)
        if not self._peers or len(data) > MAX_JOINED_BYTES:
            for chunk in chunks:
                self.write(chunk)
            return
        for _, stream, _ in self._peers.values():
            stream.write(data, len(chunks))

    def close(self) -> None:
        """Close the listener and all connections."""
        for sock, stream, _ in self._peers.values():
            stream.abandon()
            sock.close()
        self._peers.clear()
        self._listener.close()
        self._reserve.close()
        self._descriptors.close()


class TcpClient:
    """Connects to a server, again and again while there is none."""

    datagrams = False

    def __init__(self, host: str, port: int) -> None:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._family = found[0]
        self._address = found[4]
        self.name = f"tcp:{host_port(host, port)}"
        self.counters = LinkCounters()
        self._descriptors = Descriptors()
        self._peer: tuple[socket.socket, Stream] | None = None
        self._number = 0
        self._retry_s = 0.0
        self._warned = False
        self._connect()

    @property
    def peer_count(self) -> int:
        """1 while the connection stands."""
        return int(self._peer is not None and self._peer[1].open)

    def filenos(self) -> list[int]:
        """What to wait on for whatever connection there is."""
        return self._descriptors.filenos()

    def _connect(self) -> None:
        self._retry_s = time.monotonic() + RECONNECT_S
        try:
            sock = socket.socket(self._family, socket.SOCK_STREAM)
        except OSError as error:  # no descriptors: there may be some at the next attempt
            self.counters.errors += 1
            if not self._warned:
                LOG.warning("%s: no connection: %s", self.name, error)
                self._warned = True
            return
        _prepare(sock)
        # It is under way when this returns; the descriptor tells when it stands or has failed.
        sock.connect_ex(self._address)
        stream = _stream(sock, self._descriptors, self.counters)
        stream.await_open()
        self._peer = (sock, stream)

    def read(self) -> list[Chunk]:
        """Carry on connecting or writing, and collect what came."""
        if self._peer is None:
            if time.monotonic() >= self._retry_s:
                self._connect()
            return []
        sock, stream = self._peer
        if not stream.open and not self._finish_connecting(sock, stream):
            return []
        stream.flush()
        data, stands = stream.read()
        chunks = [(self._number, data)] if data else []
        if not stands:
            self._lose(sock, stream)
            chunks.append((self._number, b""))
            self._number += 1
        return chunks

    def _finish_connecting(self, sock: socket.socket, stream: Stream) -> bool:
        if not self._descriptors.ready():
            return False
        # Writable also means failed: only the socket's error tells the two apart.
        if sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) or _is_self_connected(sock):
            self._lose(sock, stream)
            return False
        stream.open = True
        return True

    def _lose(self, sock: socket.socket, stream: Stream) -> None:
        # Whoever flies should know; attempts at a server that is not there are not told.
        if stream.open:
            LOG.warning("%s: the connection was lost; it is made again", self.name)
        stream.abandon()
        sock.close()
        self._peer = None
        self.counters.errors += 1

    def write(self, data: bytes) -> None:
        """Send; while nobody answers the chunk is dropped, for it would be stale later."""
        if self._peer is None:
            self.counters.drops += 1
        else:
            self._peer[1].write(data)

    def close(self) -> None:
        """Close the connection."""
        if self._peer is not None:
            self._peer[1].abandon()
            self._peer[0].close()
            self._peer = None
        self._descriptors.close()


OPENERS = {"tcp": TcpClient, "tcpin": TcpServer}
