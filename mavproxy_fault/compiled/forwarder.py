"""The compiled form's owner: gives it its tables, and takes over what it counted.

What may go this way is decided here, message by message: nothing that the control path wants, and
only faults that can be written down as `plans`. Everything else goes the interpreted way, datagram
by datagram, in order.
"""

import socket
import time
from collections.abc import Sequence
from ctypes import c_void_p
from typing import TYPE_CHECKING, Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.object_file import load
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.proxy.routing import target_places
from mavproxy_fault.proxy.statistics import Latencies
from mavproxy_fault.proxy.tape import INDEX, Tape
from mavproxy_fault.proxy.vehicle_clock import stamp_place
from mavproxy_fault.wire.dialect import Layout, layout

if TYPE_CHECKING:
    from mavproxy_fault.compiled.plans import Plans

POLLIN = 1


class Forwarder:
    """Arrays that the machine code works on; `core.senders` is shared with the interpreted way."""

    def __init__(
        self,
        links: Sequence[Link],
        core: Core,
        latencies: Sequence[Latencies],
        base_ns: int,
        *,
        tape: Tape | None = None,
        waited: Sequence[int] = (),
    ) -> None:
        forward = load()
        assert forward is not None
        self._forward = forward
        self._links = links
        self._core = core
        self._tape = tape
        self._latencies = latencies
        descriptors = [*(link.filenos()[0] for link in links), *waited]
        arrays = k.new_arrays(len(links), len(descriptors), keep=tape is not None)
        self._arrays = {**arrays, "senders": core.senders}
        self.loop, self.ports, self.polls = arrays["loop"], arrays["ports"], arrays["polls"]
        self._read_parts = k.table("q", len(links) + 1, k.BATCH, 2)
        self._known_peers: list[list[Any]] = [[] for _ in links]
        self._learned: dict[int, Layout] = {}
        self._plans: Plans | None = None
        for n, descriptor in enumerate(descriptors):
            self.polls[n] = descriptor | POLLIN << 32
        self.loop[k.BASE], self.loop[k.KEEP] = base_ns, tape is not None
        self.loop[k.LINK_COUNT], self.loop[k.POLLS] = len(links), len(descriptors)
        self._seen: tuple[Any, ...] = ()
        self._point()
        self._tie(None)

    def _tie(self, plans: "Plans | None") -> None:
        """Give the machine code the addresses of all arrays."""
        if plans is not None:
            self._arrays |= plans.arrays
        self._addresses = (c_void_p * len(k.Shared._fields))(
            *(
                k.address(self._arrays[name]) if name in self._arrays else None
                for name in k.Shared._fields
            )
        )

    def _point(self) -> None:
        """Let the headers of both kinds of system call point to the rows of data."""
        arrays, loop = self._arrays, self.loop
        loop[k.TIME_AT] = k.address(loop) + 8 * k.SECONDS
        for place, name in (
            (k.POLLS_AT, "polls"), (k.PEERS_AT, "peers"), (k.HEADS_AT, "heads"),
            (k.HEADERS_AT, "headers"),
        ):  # fmt: skip
            loop[place] = k.address(arrays[name])
        rows, names = k.address(arrays["data"]), k.address(arrays["names"])
        heads = arrays["heads"]
        for number in range(len(self._links) + 1):
            for at in range(k.BATCH):
                row = number * k.BATCH + at
                for parts, headers in (
                    (self._read_parts, heads),
                    (arrays["parts"], arrays["headers"]),
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
        ports[number, k.COMPILED] = (
            isinstance(link, UdpServer | UdpClient) and link.sock.family == socket.AF_INET
        )
        from_vehicle = self._core.links[number].direction == "from-vehicle"
        ports[number, k.FROM_VEHICLE] = from_vehicle

    # A stretch of forwarding

    def forward(self, deadline_ns: int, *, spin: bool, precise: bool = False) -> int:
        """Forward until `deadline_ns` of the monotonic clock or until it hands something over.

        With `precise` the deadline is met to some microseconds, at the cost of processor time.
        """
        self._refresh()
        loop = self.loop
        loop[k.DEADLINE], loop[k.SPIN], loop[k.PRECISE] = deadline_ns, spin, precise
        while True:
            loop[k.DRY] = 0
            if self._plans is not None:
                self._plans.draw_ahead()
            reason = self._forward(self._addresses)
            self._settle()
            if not loop[k.DRY]:
                return reason

    def send_at(self, due_ns: int, sends: Sequence[Send]) -> bool:
        """Wait for a time of the monotonic clock, and send at once; False if not all can go so."""
        rows = len(self._links)
        if len(sends) > k.BATCH or not all(self.serves(send.link) for send in sends):
            return False
        for at, send in enumerate(sends):
            start = (rows * k.BATCH + at) * k.ROW
            self._arrays["data"][start : start + len(send.data)] = send.data
            (
                self._arrays["parts"][rows, at, k.DATA_LENGTH],
                self._arrays["heads"][rows, at, k.LENGTH],
            ) = len(send.data), send.link
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

    def handed_over(self) -> tuple[int, bytes, int]:
        """The datagram handed over: link, bytes, and when it came by the monotonic clock.

        Its sender becomes a peer; of one that may not speak there are no bytes.
        """
        number, at = int(self.loop[k.LINK]), int(self.loop[k.AT])
        self.loop[k.AT] += 1
        row = number * k.BATCH + at
        length = self._arrays["heads"][number, at, k.LENGTH] & 0xFFFFFFFF
        data = bytes(self._arrays["data"][row * k.ROW : row * k.ROW + length])
        link = self._links[number]
        if isinstance(link, UdpServer):
            name = self._arrays["names"][row * k.NAME : row * k.NAME + k.SOCKADDR_IN]
            if not link.hear(bytes(name), data):
                link.counters.refused += 1
                return number, b"", self.loop[k.CAME]
        self._learn(data)
        return number, data, self.loop[k.CAME]

    @property
    def wakes_ready(self) -> bool:
        """Whether something that is no link wants service."""
        return any(word >> 48 for word in self.polls[len(self._links) :])

    def ready(self) -> list[int]:
        """Links outside the compiled form that have something."""
        count = range(len(self._links))
        return [n for n in count if self.polls[n] >> 48 and not self.ports[n, k.COMPILED]]

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
        places = stamp_place(described.name) or (-1, 0, 0)
        values = (described.crc_extra, *places, *target_places(described.name))
        for column, value in zip(range(k.EXTRA, k.PLAN), values, strict=True):
            self._arrays["table"][number, column] = value

    def _refresh(self) -> None:
        """Follow the engine, the control path and the peers."""
        engine: Any = self._core.engine
        control = self._core.control
        seen: tuple[Any, ...] = (control and control.wanted,)
        if engine is not None:
            self.loop[k.EDGE] = engine.edge_us
            seen += (engine.changes, engine.revision, engine.t0_us)
        plans = self._plans
        if seen != self._seen or (plans is not None and plans.changed):
            if plans is not None:
                plans.clear()
            for number in self._learned:
                self._classify(number)
            self._seen = seen  # only now: what fails for want of memory is done again
        for number, link in enumerate(self._links):
            if isinstance(link, UdpServer) and [*link.peers.known] != self._known_peers[number]:
                self._known_peers[number] = [*link.peers.known]
                self.ports[number, k.PEER_COUNT] = len(link.peers.known)
                for row, name in enumerate(link.peers.known):
                    start = (number * k.PEERS + row) * k.NAME
                    self._arrays["peers"][start : start + len(name)] = name
                    self._arrays["heard"][number, row] = 0

    def _classify(self, number: int) -> None:
        """Say how a message goes."""
        kind, first = self._way(number)
        self._arrays["table"][number, k.KIND], self._arrays["table"][number, k.PLAN] = kind, first

    def _way(self, number: int) -> tuple[int, int]:
        """The kind of a message, and the first row of its faults."""
        engine: Any = self._core.engine
        control = self._core.control
        if control is not None and number in control.wanted:
            return k.INTERPRETED, -1
        if engine is None or (engine.wanted is not None and number not in engine.wanted):
            return k.PASS, -1
        acting = None if engine.t0_us is None else engine.acting(number)
        if acting is None:
            return k.INTERPRETED, -1
        if not acting:
            return k.PASS_UNTIL_EDGE, -1
        first = self._planned().add(self._learned[number], acting)
        return (k.INTERPRETED, -1) if first is None else (k.PLANNED, first)

    def _planned(self) -> "Plans":
        """The rows of faults, which a proxy without faults does without."""
        if self._plans is None:
            from mavproxy_fault.compiled.plans import Plans

            plans = Plans()
            self._tie(plans)
            self._plans = plans
        return self._plans

    # What it counted

    def _settle(self) -> None:
        """Give the engine what its faults did, and the tape what passed."""
        loop = self.loop
        engine: Any = self._core.engine
        if engine is not None and loop[k.WANTED_AT]:
            engine.now_us = max(engine.now_us, int(loop[k.WANTED_AT]))
            loop[k.WANTED_AT] = 0
        if self._plans is not None:
            self._plans.settle()
        if self._tape is not None and loop[k.RECEIVED_AT]:
            received, sent, index = (self._arrays[one] for one in ("received", "sent", "index"))
            self._tape.received += received[: loop[k.RECEIVED_AT]]
            self._tape.sent += sent[: loop[k.SENT_AT]]
            self._tape.index += index[: loop[k.INDEX_AT]]
            self.drop_tape()

    def drop_tape(self) -> int:
        """Forget what the machine code has written down of what passed; how many records."""
        loop = self.loop
        records = int(loop[k.INDEX_AT]) // INDEX.size
        loop[k.RECEIVED_AT] = loop[k.SENT_AT] = loop[k.INDEX_AT] = 0
        return records

    def count(self) -> None:
        """Add the machine code's counts to the links', the core's and the latencies."""
        ports, heard = self.ports, self._arrays["heard"]
        for number, link in enumerate(self._links):
            if not any(ports[number, column] for column in range(k.DATAGRAMS, k.LONE)):
                continue
            counters, state = link.counters, self._core.states[number]
            counters.chunks_in += ports[number, k.DATAGRAMS]
            counters.bytes_in += ports[number, k.BYTES]
            counters.chunks_out += ports[number, k.SENT]
            counters.bytes_out += ports[number, k.BYTES_SENT]
            counters.drops += ports[number, k.DROPS]
            counters.errors += ports[number, k.ERRORS]
            state.frames += ports[number, k.FRAMES]
            state.gaps += ports[number, k.MISSING]
            state.faulted += ports[number, k.FAULTED]
            for column in range(k.DATAGRAMS, k.LONE):
                ports[number, column] = 0
            start = number * k.LATENCY_STEPS
            for step, count in enumerate(
                self._arrays["histogram"][start : start + k.LATENCY_STEPS].tolist()
            ):
                if count:
                    self._latencies[number].add_step(step, count)
                    self._arrays["histogram"][start + step] = 0
            for row, name in enumerate(self._known_peers[number]):
                if heard[number, row] and isinstance(link, UdpServer):
                    link.peers.touch(name, time.monotonic())
                heard[number, row] = 0
