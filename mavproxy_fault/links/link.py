"""Link: where bytes come from and go to, without ever blocking.

A link is drained in batches: `read` hands over what waits (up to a bound), `write` sends at
once or queues within bounds. What does not fit is dropped and counted, so that a slow or dead
endpoint never stalls the others.
"""

import contextlib
import socket
from dataclasses import dataclass
from typing import Protocol

RECEIVE_BUFFER = 16 << 20  # bytes, 20,000 small frames; Linux' default loses them in bursts
QUEUE_LIMIT = 1 << 20  # bytes that wait for a slow stream before further ones are dropped
SO_RCVBUFFORCE, SO_SNDBUFFORCE = 33, 32  # Linux <asm-generic/socket.h>; need CAP_NET_ADMIN

Chunk = tuple[int, bytes]


@dataclass(slots=True)
class LinkCounters:
    """What passed one link since it was opened; a chunk is a datagram or one write."""

    chunks_in: int = 0
    bytes_in: int = 0
    chunks_out: int = 0
    bytes_out: int = 0
    drops: int = 0  # chunks that were not sent: no peer, a full queue, a lost connection
    refused: int = 0  # chunks of addresses that may not speak here
    errors: int = 0  # refused datagrams, lost connections, vanished devices


class Link(Protocol):
    """The contract of a link.

    `datagrams` tells whether chunks keep their boundaries (UDP) or are pieces of a stream. One of
    `filenos` is readable whenever `read` has something to do; `read` also carries on with pending
    writes and reconnects, so it must be called a few times a second in any case.
    """

    name: str
    datagrams: bool
    counters: LinkCounters

    @property
    def peer_count(self) -> int:
        """How many peers `write` would reach now."""

    def filenos(self) -> list[int]:
        """Descriptors for `select`, which may be others after a `read`."""

    def read(self) -> list[Chunk]:
        """What has come, as (stream, bytes).

        Streams tell the connections of one link apart: bytes of different streams never belong to
        one frame. Empty bytes say that the stream has ended.
        """

    def write(self, data: bytes) -> None:
        """Send one chunk to every peer of the link, or drop and count it."""

    def close(self) -> None:
        """Release the link; pending bytes are given up."""


def host_port(host: str, port: int) -> str:
    """HOST:PORT as connection strings have it: an IPv6 address stands in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def enlarge_buffers(sock: socket.socket) -> None:
    """Ask for 16 MiB of kernel buffer each way, beyond the system's limit where that is allowed."""
    for option, forced in (
        (socket.SO_RCVBUF, SO_RCVBUFFORCE),
        (socket.SO_SNDBUF, SO_SNDBUFFORCE),
    ):
        sock.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, forced, RECEIVE_BUFFER)
