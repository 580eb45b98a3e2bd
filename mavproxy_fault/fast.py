"""The compiled path's owner: gives it its tables, and takes over what it counted.

What may go the compiled way is decided here, message by message: nothing that the control path
wants, and only faults that can be written down as `plans`. Everything else stays with the plain
path, frame by frame, in order.
"""

import socket
from collections.abc import Sequence
from ctypes import c_void_p
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mavproxy_fault import tables as k
from mavproxy_fault.clock import stamp_place
from mavproxy_fault.core import Core
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.machine import ARRAYS, load
from mavproxy_fault.routing import target_places
from mavproxy_fault.stats import Latencies
from mavproxy_fault.tape import Tape
from mavproxy_fault.wire.dialect import Layout, layout

if TYPE_CHECKING:
    from mavproxy_fault.plans import Plans

POLLIN = 1


class FastPath:
    """Arrays that the machine code works on; `core.memory` is shared with the plain path."""

    def __init__(
        self,
        links: Sequence[Link],
        core: Core,
        tape: Tape | None,
        latencies: Sequence[Latencies],
        base_ns: int,
        others: Sequence[int],
    ) -> None:
        forward = load()
        assert forward is not None
        self._forward = forward
        self._links = links
        self._core = core
        self._tape = tape
        self._latencies = latencies
        count = len(links)
        self.ports = np.zeros((count, k.PORT_SIZE), np.int64)
        self._data = np.empty(count * k.BATCH * k.ROW, np.uint8)
        self._heads = np.zeros((count, k.BATCH, 8), np.int64)
        self._headers = np.zeros((count, k.BATCH, 8), np.int64)
        self._parts = np.zeros((count, k.BATCH, 2), np.int64)
        self._read_parts = np.zeros((count, k.BATCH, 2), np.int64)
        self._names = np.zeros((count, k.BATCH, k.NAME), np.uint8)
        self._peers = np.zeros((count, k.PEERS, k.NAME), np.uint8)
        self._heard = np.zeros((count, k.PEERS), np.uint8)
        self._known_peers: list[list[Any]] = [[] for _ in links]
        self._table = np.zeros((k.IDS, 8), np.int64)
        self._learned: dict[int, Layout] = {}
        self._plans: Plans | None = None
        self._histogram = np.zeros((count, k.LATENCY_STEPS), np.int64)
        self._logs = [np.empty(k.LOG_SIZE if tape is not None else 1, np.uint8) for _ in range(3)]
        self.turn = np.zeros(k.TURN_SIZE, np.int64)
        self.polls = np.array(
            [fd | POLLIN << 32 for fd in (*(link.fileno() for link in links), *others)], np.int64
        )
        self.turn[k.BASE], self.turn[k.KEEP] = base_ns, tape is not None
        self.turn[k.LINK_COUNT], self.turn[k.POLLS] = count, len(self.polls)
        self._seen: tuple[Any, ...] = ()
        self._point()
        self._tie()

    def _tie(self) -> None:
        """Give the machine code the addresses of all arrays."""
        plans = self._plans
        arrays = {
            "histogram": self._histogram, "polls": self.polls, "turn": self.turn,
            "ports": self.ports, "heads": self._heads, "headers": self._headers,
            "parts": self._parts, "names": self._names, "peers": self._peers,
            "heard": self._heard, "data": self._data,
            "memory": np.frombuffer(cast(Any, self._core.memory), np.int64),
            "table": self._table, "received": self._logs[0], "sent": self._logs[1],
            "index": self._logs[2], "crc": k.crc_tables(), "result": np.zeros(2),
        }  # fmt: skip
        if plans is not None:
            arrays |= {
                "plans": plans.rows, "numbers": plans.numbers, "hits": plans.hits,
                "steps": plans.steps, "pieces": plans.pieces, "draws": plans.draws,
            }  # fmt: skip
        self._arrays = arrays  # keeps them alive
        self._addresses = [
            arrays[name].ctypes.data_as(c_void_p) if name in arrays else None for name in ARRAYS
        ]

    def _point(self) -> None:
        """Let the headers of both kinds of system call point to the rows of data."""
        step = np.arange(len(self._links) * k.BATCH).reshape(len(self._links), k.BATCH)
        rows = self._data.ctypes.data + k.ROW * step
        for parts, headers in ((self._read_parts, self._heads), (self._parts, self._headers)):
            parts[:, :, 0], parts[:, :, 1] = rows, k.ROW
            headers[:, :, 2] = parts.ctypes.data + 16 * step
            headers[:, :, 3] = 1
        self._heads[:, :, 0], self._heads[:, :, 1] = self._names.ctypes.data + k.NAME * step, k.NAME
        for number, link in enumerate(self._links):
            port = self.ports[number]
            port[k.FD] = link.fileno()
            port[k.LISTENS] = isinstance(link, UdpServer)
            port[k.FAST] = (
                isinstance(link, UdpServer | UdpClient) and link.sock.family == socket.AF_INET
            )
            port[k.FROM_VEHICLE] = self._core.links[number].direction == "from-vehicle"
        turn = self.turn
        turn[k.TIME_AT] = turn.ctypes.data + 8 * k.SECONDS
        turn[k.POLLS_AT], turn[k.PEERS_AT] = self.polls.ctypes.data, self._peers.ctypes.data
        turn[k.HEADS_AT], turn[k.HEADERS_AT] = self._heads.ctypes.data, self._headers.ctypes.data

    # A stretch of forwarding

    def forward(self, deadline_ns: int, *, spin: bool, precise: bool = False) -> int:
        """Forward until `deadline_ns` of the monotonic clock or until the plain path is needed.

        With `precise` the deadline is met to some microseconds, at the cost of processor time.
        """
        self._refresh()
        turn = self.turn
        turn[k.DEADLINE], turn[k.SPIN], turn[k.PRECISE] = deadline_ns, spin, precise
        while True:
            turn[k.DRY] = 0
            if self._plans is not None:
                self._plans.draw_ahead()
            reason = self._forward(*self._addresses)
            self._settle()
            if not turn[k.DRY]:
                return reason

    def takes(self, number: int) -> bool:
        """Whether a link goes the compiled way."""
        return bool(self.ports[number, k.FAST])

    @property
    def pending(self) -> bool:
        """Whether received datagrams still wait in the rows."""
        return bool(self.turn[k.AT] < self.turn[k.COUNT])

    def take_datagram(self) -> tuple[int, bytes]:
        """The datagram that was not plain, and its link; its sender becomes a peer."""
        number, at = int(self.turn[k.LINK]), int(self.turn[k.AT])
        self.turn[k.AT] += 1
        start = (number * k.BATCH + at) * k.ROW
        data = self._data[start : start + (int(self._heads[number, at, 7]) & 0xFFFFFFFF)].tobytes()
        link = self._links[number]
        if isinstance(link, UdpServer):
            link.hear(self._names[number, at, : k.SOCKADDR_IN].tobytes())
        self._learn(data)
        return number, data

    @property
    def others_ready(self) -> bool:
        """Whether something that is no link wants service."""
        return bool((self.polls[len(self._links) :] >> 48 != 0).any())

    def ready(self) -> list[int]:
        """Links outside the compiled path that have something."""
        waiting = (self.polls[: len(self._links)] >> 48 != 0) & (self.ports[:, k.FAST] == 0)
        return [int(number) for number in np.flatnonzero(waiting)]

    # Tables

    def _learn(self, data: bytes) -> None:
        """Take up the messages of a datagram that are new."""
        if len(data) < 8:
            return
        number = int.from_bytes(data[7:10], "little") if data[0] == 0xFD else data[5]
        if number in self._learned or number >= k.IDS:
            return
        described = layout(number)
        if described is not None:
            self._learned[number] = described
            self._describe(number, described)
            self._classify(number)

    def _describe(self, number: int, described: Layout) -> None:
        entry = self._table[number]
        entry[k.EXTRA] = described.crc_extra
        entry[k.STAMP_AT], entry[k.STAMP_SIZE], entry[k.STAMP_SCALE] = stamp_place(
            described.name
        ) or (-1, 0, 0)
        entry[k.TARGET_SYSTEM], entry[k.TARGET_COMPONENT] = target_places(described.name)

    def _refresh(self) -> None:
        """Follow the engine, the control path and the peers."""
        engine: Any = self._core.engine
        control = self._core.control
        seen: tuple[Any, ...] = (control and control.wanted,)
        if engine is not None:
            self.turn[k.EDGE] = engine.edge_us
            seen += (engine.turns, engine.revision, engine.t0_us)
        plans = self._plans
        if seen != self._seen or (plans is not None and plans.changed):
            self._seen = seen
            if plans is not None:
                plans.clear()
            for number in self._learned:
                self._classify(number)
        for number, link in enumerate(self._links):
            if isinstance(link, UdpServer) and [*link.peers] != self._known_peers[number]:
                self._known_peers[number] = [*link.peers]
                self._heard[number] = 0
                self.ports[number, k.PEER_COUNT] = len(link.peers)
                for row, name in enumerate(link.peers):
                    self._peers[number, row, : len(name)] = np.frombuffer(name, np.uint8)

    def _classify(self, number: int) -> None:
        """Say how a message goes."""
        entry = self._table[number]
        engine: Any = self._core.engine
        control = self._core.control
        if control is not None and number in control.wanted:
            entry[k.KIND] = k.PLAIN
        elif engine is None or (engine.wanted is not None and number not in engine.wanted):
            entry[k.KIND] = k.PASS
        elif engine.t0_us is None or (acting := engine.acting(number)) is None:
            entry[k.KIND] = k.PLAIN
        elif not acting:
            entry[k.KIND] = k.PASS_UNTIL_EDGE
        else:
            first = self._planned().add(self._learned[number], acting)
            entry[k.KIND] = k.PLAIN if first is None else k.PLANNED
            entry[k.PLAN] = -1 if first is None else first

    def _planned(self) -> "Plans":
        """The rows of faults, which a proxy without faults does without."""
        if self._plans is None:
            from mavproxy_fault.plans import Plans

            self._plans = Plans()
            self._tie()
        return self._plans

    # What it counted

    def _settle(self) -> None:
        """Give the engine what its faults did, and the tape what passed."""
        turn = self.turn
        engine: Any = self._core.engine
        if engine is not None and turn[k.WANTED_AT]:
            engine.now_us = max(engine.now_us, int(turn[k.WANTED_AT]))
            turn[k.WANTED_AT] = 0
        if self._plans is not None:
            self._plans.settle()
        if self._tape is not None and turn[k.RECEIVED_AT]:
            received, sent, index = self._logs
            self._tape.received += received[: turn[k.RECEIVED_AT]].tobytes()
            self._tape.sent += sent[: turn[k.SENT_AT]].tobytes()
            self._tape.index += index[: turn[k.INDEX_AT]].tobytes()
            turn[k.RECEIVED_AT] = turn[k.SENT_AT] = turn[k.INDEX_AT] = 0

    def count(self) -> None:
        """Add the kernel's counts to the links', the core's and the latencies."""
        for number, link in enumerate(self._links):
            port = self.ports[number]
            counters, state = link.counters, self._core.states[number]
            counters.chunks_in += int(port[k.DATAGRAMS])
            counters.bytes_in += int(port[k.BYTES])
            counters.chunks_out += int(port[k.SENT])
            counters.bytes_out += int(port[k.BYTES_SENT])
            counters.drops += int(port[k.DROPS])
            counters.errors += int(port[k.ERRORS])
            state.frames += int(port[k.FRAMES])
            state.gaps += int(port[k.MISSING])
            state.faulted += int(port[k.FAULTED])
            port[k.DATAGRAMS : k.LONE] = 0
            for step in np.flatnonzero(self._histogram[number]):
                self._latencies[number].add_step(int(step), int(self._histogram[number, step]))
            self._histogram[number] = 0
            if isinstance(link, UdpServer):
                for row in np.flatnonzero(self._heard[number]):
                    link.hear(self._known_peers[number][row])
                self._heard[number] = 0
