"""The compiled path's owner: gives `kernel` its tables, and takes over what it counted.

What may go the compiled way is decided here, message by message: nothing that the control path
wants, and of the faults only constant and linearly growing ones on numbers. Everything else stays
with the plain path, frame by frame, in order.
"""

import socket
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from mavproxy_fault import kernel as k
from mavproxy_fault.clock import stamp_place
from mavproxy_fault.core import Core
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.pump import forward as pump_forward
from mavproxy_fault.routing import target_places
from mavproxy_fault.stats import Latencies
from mavproxy_fault.tape import Tape
from mavproxy_fault.wire.dialect import Layout, layout

IDS = 1 << 16
MOST_PLANS = 256
MODES = {"add": k.ADD, "scale": k.SCALE, "replace": k.REPLACE}
POLLIN = 1
SOCKADDR_IN = 16  # bytes of an IPv4 socket address


class FastPath:
    """Arrays that the kernel works on; `core.memory` is shared with the plain path."""

    def __init__(
        self,
        links: Sequence[Link],
        core: Core,
        tape: Tape | None,
        latencies: Sequence[Latencies],
        base_ns: int,
        others: Sequence[int],
    ) -> None:
        self._links = links
        self._core = core
        self._tape = tape
        self._latencies = latencies
        count = len(links)
        self.ports = np.zeros((count, 14), np.int64)
        self._data = np.empty(count * k.BATCH * k.ROW, np.uint8)
        self._heads = np.zeros((count, k.BATCH, 8), np.int64)
        self._headers = np.zeros((count, k.BATCH, 8), np.int64)
        self._parts = np.zeros((count, k.BATCH, 2), np.int64)
        self._read_parts = np.zeros((count, k.BATCH, 2), np.int64)
        self._names = np.zeros((count, k.BATCH, k.NAME), np.uint8)
        self._peers = np.zeros((count, k.PEERS, k.NAME), np.uint8)
        self._heard = np.zeros((count, k.PEERS), np.uint8)
        self._known_peers: list[list[Any]] = [[] for _ in links]
        self._table = np.zeros((IDS, 8), np.int64)
        self._learned: dict[int, Layout] = {}
        self._plans = np.zeros((MOST_PLANS, 8), np.int64)
        self._numbers = np.zeros((MOST_PLANS, 2))
        self._hits = np.zeros((MOST_PLANS, 3), np.int64)
        self._steps = np.full(MOST_PLANS, -1.0)
        self._planned: list[tuple[int, Any, Any]] = []  # first row, running entry, its fault
        self._histogram = np.zeros((count, 64 * 8), np.int64)
        self.turn = np.zeros(16, np.int64)
        self.turn[k.BASE], self.turn[k.KEEP] = base_ns, tape is not None
        size = k.LOG_SIZE if tape is not None else 1
        self._logs = tuple(np.empty(n, np.uint8) for n in (size, size, max(size // 2, 1)))
        self._seen: tuple[Any, ...] = ()
        self._point()
        self._watch([*(link.fileno() for link in links), *others])
        net = (
            self.ports, self._heads, self._headers, self._parts, self._names, self._peers,
            np.full(count, SOCKADDR_IN, np.int64), self._heard,
        )  # fmt: skip
        wire = (
            self._data, np.frombuffer(cast(Any, core.memory), np.int64), self._table, self._plans,
            *self._logs, self._numbers, self._hits, self._steps, k.crc_tables(), np.zeros(2),
        )  # fmt: skip
        self._arguments = (self._histogram, self.polls, self.turn, net, wire)

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

    def _watch(self, descriptors: Sequence[int]) -> None:
        self.polls = np.array([fd | POLLIN << 32 for fd in descriptors], np.int64)
        self.turn[k.POLLS] = len(descriptors)

    # A stretch of forwarding

    def forward(self, deadline_ns: int, *, spin: bool) -> int:
        """Forward until `deadline_ns` of the monotonic clock or until the plain path is needed."""
        self._refresh()
        self.turn[k.DEADLINE], self.turn[k.SPIN] = deadline_ns, spin
        reason: int = pump_forward(*self._arguments)
        self._settle()
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
            link.hear(self._names[number, at, :SOCKADDR_IN].tobytes())
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
        if number in self._learned or number >= IDS:
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
        faults_changed = any(running.fault is not fault for _, running, fault in self._planned)
        if seen != self._seen or faults_changed or self._unbegun:
            self._seen = seen
            self._planned = []
            for number in self._learned:
                self._classify(number)
        for number, link in enumerate(self._links):
            if isinstance(link, UdpServer) and [*link.peers] != self._known_peers[number]:
                self._known_peers[number] = [*link.peers]
                self._heard[number] = 0
                self.ports[number, k.PEER_COUNT] = len(link.peers)
                for row, name in enumerate(link.peers):
                    self._peers[number, row, : len(name)] = np.frombuffer(name, np.uint8)

    @property
    def _unbegun(self) -> bool:
        """Whether a fault that could be compiled has yet to write its first or next label."""
        return any(running.first_us is None or running.untold for _, running, _ in self._planned)

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
            planned = len(acting) == 1 and self._plan(number, acting[0])
            entry[k.KIND] = k.PLANNED if planned else k.PLAIN

    def _plan(self, number: int, running: Any) -> bool:
        """Write a fault's rows; False where it must stay with the plain path."""
        from mavproxy_fault.faults.driven import Bias, Constant, Drift, Scale
        from mavproxy_fault.faults.value import each

        fault, where = running.fault, running.entry.where
        if type(fault) not in (Bias, Constant, Drift, Scale) or getattr(fault, "profile", None):
            return False
        places = fault.elements.get(number, ())
        first = max((row + int(self._plans[row, k.ROWS]) for row, _, _ in self._planned), default=0)
        fields = [self._learned[number].fields[name] for name, _ in places]
        if (
            running.entry.probability < 1
            or where.id is not None
            or first + len(places) > MOST_PLANS
            or not all(field.code in "bBhHiIfd" for field in fields)
        ):
            return False
        self._planned.append((first, running, fault))
        self._table[number, k.PLAN] = first
        if running.first_us is None or running.untold:
            self._plans[first, k.ROWS] = 1
            return False  # its first frame, and with it the label, are the plain path's
        grows = type(fault) is Drift
        mode = k.GROW if grows else MODES[fault.mode]
        limit = fault.limit if grows and fault.limit is not None else np.inf
        way = {None: -1, "to-vehicle": 0, "from-vehicle": 1}[where.direction]
        whom = [-1 if one is None else one for one in (where.system, where.component)]
        values = each(fault.value, len(places))
        for n, (field, (_, index), value) in enumerate(zip(fields, places, values, strict=True)):
            offset = field.offset + index * field.size
            row = (offset, ord(field.code), mode, len(places), *whom, way, running.start_us)
            self._plans[first + n] = row
            self._numbers[first + n] = value, limit
        self._hits[first] = 0
        self._steps[first] = -1.0
        return True

    # What it counted

    def _settle(self) -> None:
        """Give the engine what its faults did, and the tape what passed."""
        turn = self.turn
        engine: Any = self._core.engine
        if engine is not None and turn[k.WANTED_AT]:
            engine.now_us = max(engine.now_us, int(turn[k.WANTED_AT]))
            turn[k.WANTED_AT] = 0
        if turn[k.HITS]:
            turn[k.HITS] = 0
            for first, running, _ in self._planned:
                frames, saturated, last_us = (int(n) for n in self._hits[first])
                if frames:
                    running.credit(frames, saturated, last_us, float(self._steps[first]))
                    self._hits[first] = 0
                    self._steps[first] = -1.0
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
            port[k.DATAGRAMS :] = 0
            for step in np.flatnonzero(self._histogram[number]):
                self._latencies[number].add_step(int(step), int(self._histogram[number, step]))
            self._histogram[number] = 0
            if isinstance(link, UdpServer):
                for row in np.flatnonzero(self._heard[number]):
                    link.hear(self._known_peers[number][row])
                self._heard[number] = 0


def compile_now() -> None:
    """Load the kernel's machine code, or make it, by letting it look at nothing."""
    core = Core(())
    path = FastPath((), core, None, (), 0, ())
    path.forward(0, spin=True)
