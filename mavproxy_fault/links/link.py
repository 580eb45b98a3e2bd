"""Link: the contract of a non-blocking connection that carries MAVLink bytes.

A link is read in batches: `read` returns what has arrived (up to a bound), `write` sends at once
or queues within bounds. Data that do not fit are dropped and counted, so that a slow or dead
endpoint never stalls the others.
"""

import contextlib
import socket
from dataclasses import dataclass
from typing import Protocol

RECEIVE_BUFFER = 16 << 20  # bytes, 20,000 small frames; Linux's default overflows in bursts
QUEUE_LIMIT = 1 << 20  # bytes queued for a slow stream before further chunks are dropped
SO_RCVBUFFORCE, SO_SNDBUFFORCE = 33, 32  # Linux <asm-generic/socket.h>; need CAP_NET_ADMIN

Chunk = tuple[int, bytes]


@dataclass(slots=True)
class LinkCounters:
    """Traffic of one link since it was opened; a chunk is a datagram or one write."""

    chunks_in: int = 0
    bytes_in: int = 0
    chunks_out: int = 0
    bytes_out: int = 0
    drops: int = 0  # chunks not sent: no peer, a full queue, a lost connection
    refused: int = 0  # chunks from addresses that are not admitted
    errors: int = 0  # refused datagrams, lost connections, vanished devices


class Link(Protocol):
    """The contract of a link.

    `datagrams` is true if chunks keep their boundaries (UDP), false if they are parts of a stream.
    One of `filenos` is readable whenever `read` has work to do. `read` also continues pending
    writes and reconnects, so it must be called a few times per second in any case.
    """

    name: str
    datagrams: bool
    counters: LinkCounters

    @property
    def peer_count(self) -> int:
        """Number of peers that `write` reaches."""

    def filenos(self) -> list[int]:
        """Return the descriptors for `select`; they may change with each `read`."""

    def read(self) -> list[Chunk]:
        """Return received data as (stream, bytes).

        The stream number identifies a connection of the link: a frame never spans two streams.
        Empty bytes mean that the stream has ended.
        """

    def write(self, data: bytes) -> None:
        """Send one chunk to every peer of the link, or drop and count it."""

    def close(self) -> None:
        """Close the link; queued bytes are discarded."""


def host_port(host: str, port: int) -> str:
    """Format HOST:PORT for a connection string; an IPv6 address is put in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def enlarge_buffers(sock: socket.socket) -> None:
    """Set kernel buffers to 16 MiB each way, exceeding the system limit if permitted."""
    for option, forced in (
        (socket.SO_RCVBUF, SO_RCVBUFFORCE),
        (socket.SO_SNDBUF, SO_SNDBUFFORCE),
    ):
        sock.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, forced, RECEIVE_BUFFER)
