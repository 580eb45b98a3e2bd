"""Runs the compiled form on sockets: gives it the links and collects its counters."""

import socket
import time
from collections.abc import Sequence
from typing import Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.compiled_core import CompiledCore, frame_length
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.proxy.statistics import LatencyHistogram

POLLIN = 1
NAME_SIZES = {socket.AF_INET: 16, socket.AF_INET6: 28}  # bytes of a socket address


class Forwarder(CompiledCore):
    """Forwards between links in compiled code; hands over, in order, what that cannot process."""

    def __init__(
        self,
        links: Sequence[Link],
        core: Core,
        latencies: Sequence[LatencyHistogram],
        base_ns: int,
        *,
        tape: CaptureBuffer | None = None,
        waited: Sequence[int] = (),
    ) -> None:
        descriptors = [*(link.filenos()[0] for link in links), *waited]
        super().__init__(core, len(descriptors), tape)
        self._links = links
        self._latencies = latencies
        self.polls = self.shared.polls
        self._read_parts = k.table("q", len(links) + 1, k.BATCH, 2)
        self._known_peers: list[list[Any]] = [[] for _ in links]
        for n, descriptor in enumerate(descriptors):
            self.polls[n] = descriptor | POLLIN << 32
        self.loop[k.BASE] = base_ns
        self._point()

    def _point(self) -> None:
        """Let the headers of both kinds of system call point to the rows of data."""
        shared, loop = self.shared, self.loop
        for place, array in (
            (k.POLLS_AT, shared.polls), (k.PEERS_AT, shared.peers), (k.HEADS_AT, shared.heads),
            (k.HEADERS_AT, shared.headers),
        ):  # fmt: skip
            loop[place] = k.address(array)
        rows, names, heads = k.address(shared.data), k.address(shared.names), shared.heads
        for number in range(len(self._links) + 1):
            for at in range(k.BATCH):
                row = number * k.BATCH + at
                for parts, headers in (
                    (self._read_parts, heads),
                    (shared.parts, shared.headers),
                ):
                    parts[number, at, k.DATA_AT] = rows + k.ROW * row
                    parts[number, at, k.DATA_LENGTH] = k.ROW
                    headers[number, at, k.PARTS_AT] = k.address(parts) + 16 * row
                    headers[number, at, k.PART_COUNT] = 1
                heads[number, at, k.NAME_AT] = names + k.NAME * row
                heads[number, at, k.NAME_LENGTH] = k.NAME
        for number, link in enumerate(self._links):
            self._describe_port(number, link)
            loop[k.COMPILED_LINKS] |= self.ports[number, k.COMPILED] << number

    def _describe_port(self, number: int, link: Link) -> None:
        ports = self.ports
        ports[number, k.FD] = link.filenos()[0]
        ports[number, k.LISTENS] = isinstance(link, UdpServer)
        ports[number, k.COMPILED] = isinstance(link, UdpServer | UdpClient)
        if isinstance(link, UdpServer):
            ports[number, k.NAME_SIZE] = NAME_SIZES[link.sock.family]

    # A stretch of forwarding

    def forward(self, deadline_ns: int, *, spin: bool, precise: bool = False) -> int:
        """Forward until `deadline_ns` of the monotonic clock or until the core had to take a frame.

        With `precise` the deadline is met to some microseconds, at the cost of processor time.
        """
        self._refresh()
        loop = self.loop
        loop[k.DEADLINE], loop[k.SPIN], loop[k.PRECISE] = deadline_ns, spin, precise
        if self.pending:  # delayed frames may have been sent while it waited within its batch
            last_due_ns = self._core.last_due_us * 1000 - loop[k.BASE]
            loop[k.CAME] = max(loop[k.CAME], last_due_ns)
        reason = self._forward(self._addresses)
        now_us = (loop[k.BASE] + loop[k.CAME]) // 1000
        if loop[k.OTHERS]:
            others = loop[k.OTHERS]
            self._sends += self._segments(loop[k.LINK], others, now_us)
            loop[k.OTHERS] = 0
        self._settle(now_us, plain=reason == k.OTHER_READY)
        if reason == k.HANDED_OVER:
            self._take_over(now_us)
        return reason

    def send_at(self, due_ns: int, sends: Sequence[Send]) -> bool:
        """Wait for a time of the monotonic clock, and send at once; False if not all can go so."""
        rows = len(self._links)
        if len(sends) > k.BATCH or not all(self.serves(send.link) for send in sends):
            return False
        for at, send in enumerate(sends):
            start = (rows * k.BATCH + at) * k.ROW
            self.shared.data[start : start + len(send.data)] = send.data
            part = rows, at
            self.shared.parts[*part, k.DATA_AT] = k.address(self.shared.data) + start
            self.shared.parts[*part, k.DATA_LENGTH] = len(send.data)
            self.shared.heads[*part, k.LENGTH] = send.link
        self._refresh()
        self.loop[k.DUE_COUNT], self.loop[k.DUE_AT] = len(sends), due_ns
        self._forward(self._addresses)
        return True

    def serves(self, number: int) -> bool:
        """Whether a link goes this way."""
        return bool(self.ports[number, k.COMPILED])

    @property
    def pending(self) -> bool:
        """Whether received datagrams still wait in the rows."""
        return bool(self.loop[k.AT] < self.loop[k.COUNT])

    def _take_over(self, now_us: int) -> None:
        """Let the core take the frame, or rest of a datagram, at which the machine code stopped.

        Its sender becomes a peer, unless it may not speak.
        """
        loop = self.loop
        number, at, begin = int(loop[k.LINK]), int(loop[k.AT]), int(loop[k.ROW_AT])
        row = number * k.BATCH + at
        length = self.shared.heads[number, at, k.LENGTH] & 0xFFFFFFFF
        data = bytes(self.shared.data[row * k.ROW + begin : row * k.ROW + length])
        if loop[k.FOUND] == k.FRAME:
            data = data[: frame_length(data, 0)]
        loop[k.ROW_AT] = begin + len(data)
        if loop[k.ROW_AT] >= length:
            loop[k.AT], loop[k.ROW_AT] = at + 1, 0
        link = self._links[number]
        if isinstance(link, UdpServer):
            start = row * k.NAME
            name = self.shared.names[start : start + self.ports[number, k.NAME_SIZE]]
            if not link.register(bytes(name), data):
                link.counters.refused += 1
                loop[k.AT], loop[k.ROW_AT] = at + 1, 0
                return
        if data:
            self._sends += self._give(number, data, now_us, begun=begin > 0)
            self._latencies[number].add(time.monotonic_ns() - loop[k.CAME])

    @property
    def wakes_ready(self) -> bool:
        """Whether a descriptor other than a link is ready."""
        return any(word >> 48 for word in self.polls[len(self._links) :])

    def ready(self) -> list[int]:
        """Links outside the compiled form that have something."""
        count = range(len(self._links))
        return [n for n in count if self.polls[n] >> 48 and not self.ports[n, k.COMPILED]]

    def _refresh(self) -> None:
        """Follow the engine, the control path and the peers."""
        super()._refresh()
        for number, link in enumerate(self._links):
            if (
                isinstance(link, UdpServer)
                and [*link.peers.by_address] != self._known_peers[number]
            ):
                self._known_peers[number] = [*link.peers.by_address]
                self.ports[number, k.PEER_COUNT] = len(link.peers.by_address)
                for row, name in enumerate(link.peers.by_address):
                    start = (number * k.PEERS + row) * k.NAME
                    self.shared.peers[start : start + len(name)] = name
                    self.shared.heard[number, row] = 0

    # What it counted

    def count(self) -> None:
        """Add the machine code's counts to the links', the core's and the latencies."""
        super().count()
        ports, heard = self.ports, self.shared.heard
        for number, link in enumerate(self._links):
            if not any(ports[number, column] for column in range(k.DATAGRAMS, k.LONE)):
                continue
            counters = link.counters
            counters.chunks_in += ports[number, k.DATAGRAMS]
            counters.bytes_in += ports[number, k.BYTES]
            counters.chunks_out += ports[number, k.SENT]
            counters.bytes_out += ports[number, k.BYTES_SENT]
            counters.drops += ports[number, k.DROPS]
            counters.errors += ports[number, k.ERRORS]
            for column in range(k.DATAGRAMS, k.LONE):
                ports[number, column] = 0
            for step in range(k.LATENCY_STEPS):
                if count := self.shared.histogram[number, step]:
                    self._latencies[number].add_step(step, count)
                    self.shared.histogram[number, step] = 0
            for row, name in enumerate(self._known_peers[number]):
                if heard[number, row] and isinstance(link, UdpServer):
                    link.peers.confirm(name, time.monotonic())
                heard[number, row] = 0
