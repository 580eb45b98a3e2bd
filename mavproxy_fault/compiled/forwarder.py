"""Runs the compiled form on sockets: gives it the links and collects its counters."""

import socket
import time
from collections.abc import Sequence
from typing import Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.statistics import LatencyHistogram

POLLIN = 1
NAME_SIZES = {socket.AF_INET: 16, socket.AF_INET6: 28}  # bytes of a socket address

COUNTERS = {
    k.DATAGRAMS: "chunks_in", k.BYTES: "bytes_in", k.SENT: "chunks_out",
    k.BYTES_SENT: "bytes_out", k.DROPS: "drops", k.ERRORS: "errors",
}  # fmt: skip


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
        self._known_peers: list[list[Any]] = [[] for _ in links]
        for n, descriptor in enumerate(descriptors):
            self.polls[n] = descriptor | POLLIN << 32
        loop, own = self.loop, k.address(self.loop)
        loop[k.BASE], loop[k.POLLS_AT] = base_ns, k.address(self.polls)
        loop[k.TIME_AT], loop[k.NAME_LENGTH_AT] = own + 8 * k.SECONDS, own + 8 * k.NAME_LENGTH
        self._streams = [0] * len(links)  # the number of each link's only stream
        for number, link in enumerate(links):
            self._describe_port(number, link)

    def _describe_port(self, number: int, link: Link) -> None:
        ports = self.ports
        ports[number, k.FD] = link.filenos()[0]
        ports[number, k.LISTENS] = isinstance(link, UdpServer)
        ports[number, k.COMPILED] = isinstance(link, UdpServer | UdpClient)
        ports[number, k.STREAM] = not link.datagrams
        if isinstance(link, UdpServer):
            ports[number, k.NAME_SIZE] = NAME_SIZES[link.sock.family]

    # A stretch of forwarding

    def forward(self, deadline_ns: int, *, spin: bool) -> int:
        """Forward until `deadline_ns` of the monotonic clock or the core had to take a frame."""
        self._refresh()
        loop = self.loop
        loop[k.DEADLINE], loop[k.SPIN] = deadline_ns, spin
        reason = self._forward(self._addresses)
        now_us = (loop[k.BASE] + loop[k.CAME]) // 1000
        if reason == k.HANDED_OVER:
            self._take_over(now_us)
            return reason
        if reason == k.TO_SETTLE:
            for send in self._segments(loop[k.OTHERS]):
                went = self.ports[send.link, k.WENT]  # of it, or of what was before it
                self.ports[send.link, k.WENT] = max(went - len(send.data), 0)
                if went < len(send.data):
                    self._sends.append(send._replace(data=send.data[went:]))
        self._settle(now_us)
        return reason

    def serves(self, number: int) -> bool:
        """Whether a link always goes this way; a stream only while it has one peer."""
        return bool(self.ports[number, k.COMPILED]) and not self.ports[number, k.STREAM]

    def _take_over(self, now_us: int) -> None:
        """Finish a datagram that machine code has stopped in, with the core.

        Its sender becomes a peer, unless it may not speak.
        """
        number = int(self.loop[k.LINK])
        data = bytes(self.shared.data[: self.loop[k.LENGTH]])
        link = self._links[number]
        if isinstance(link, UdpServer):
            name = self.shared.name[: self.ports[number, k.NAME_SIZE]]
            if not link.peers.register(bytes(name), data, time.monotonic()):
                link.counters.refused += 1
                return
        came_ns = self.loop[k.CAME]
        if data:
            sends = self.finish(number, data, now_us, stream=self._streams[number])
            self._sends += sends
            self._latencies[number].add(time.monotonic_ns() - came_ns)

    @property
    def wakes_ready(self) -> bool:
        """Whether a descriptor other than a link is ready."""
        return any(word >> 48 for word in self.polls[len(self._links) :])

    def ready(self) -> list[int]:
        """Links outside the compiled form that have something.

        Their bytes are counted first: a stream whose end is read now may have been heard.
        """
        ports, links = self.ports, enumerate(self._links)
        found = [n for n, _ in links if self.polls[n] >> 48 and not ports[n, k.COMPILED]]
        for number in found:
            self._links[number].counters.bytes_in += ports[number, k.BYTES]
            ports[number, k.BYTES] = 0
        return found

    def _refresh(self) -> None:
        """Follow the engine, the control path and the peers."""
        super()._refresh()
        for number, link in enumerate(self._links):
            if self.ports[number, k.STREAM]:
                self._follow_stream(number, link)
            bit = 1 << number
            self.loop[k.COMPILED_LINKS] &= ~bit
            self.loop[k.COMPILED_LINKS] |= bit * self.ports[number, k.COMPILED]
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

    def _follow_stream(self, number: int, link: Any) -> None:
        """Take a stream that has one peer, with nothing in its queue and no incomplete frame."""
        peer = link.lone_peer() if hasattr(link, "lone_peer") else None
        taken = peer is not None and not self._core.is_incomplete(number, peer[1])
        if peer is not None:
            self.ports[number, k.FD], self._streams[number] = peer
        self.ports[number, k.COMPILED] = taken

    # What it counted

    def count(self) -> None:
        """Add the machine code's counts to the links', the core's and the latencies."""
        super().count()
        ports, heard = self.ports, self.shared.heard
        for number, link in enumerate(self._links):
            if not any(ports[number, column] for column in COUNTERS):
                continue
            for column, name in COUNTERS.items():
                setattr(link.counters, name, getattr(link.counters, name) + ports[number, column])
                ports[number, column] = 0
            for step in range(k.LATENCY_STEPS):
                if count := self.shared.histogram[number, step]:
                    self._latencies[number].add_step(step, count)
                    self.shared.histogram[number, step] = 0
            for row, name in enumerate(self._known_peers[number]):
                if heard[number, row] and isinstance(link, UdpServer):
                    link.peers.confirm(name, time.monotonic())
                heard[number, row] = 0
