"""Core: the proxy without sockets, files or clocks.

Bytes of a link come in with the wall time they came at; sends with their due times come out. In
between every frame is verified, recorded, given to the fault engine where it wants it, and routed.
Frames that nothing touched keep their bytes, and their datagram where they came in one.

Whatever is sent depends on the input and its stamps alone, never on when `due` was called, so a
recording played back with the same schedule gives the same bytes.
"""

import dataclasses
import heapq
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mavproxy_fault.proxy.announcements import label_announcement
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.interfaces import CommandResponder, Direction, FaultEngine, LinkRole, Send
from mavproxy_fault.proxy.numbering import Numbering
from mavproxy_fault.proxy.outgoing_batch import OutgoingBatch, join_datagrams, source_of
from mavproxy_fault.proxy.resync_deadline import ResyncDeadline
from mavproxy_fault.proxy.routing import LoopGuard, Routes
from mavproxy_fault.proxy.sender_rules import missing_before
from mavproxy_fault.proxy.senders import (
    GAPS,
    LINKS,
    SENDERS,
    T0,
    UNCONFIRMED,
    UNKNOWN,
    VEHICLE_SYSTEM,
    WALL_OFFSET,
    new_senders,
)
from mavproxy_fault.proxy.vehicle_clock import VehicleClock
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Junk, Parser, ParserCounters
from mavproxy_fault.wire.signing import Signing

if TYPE_CHECKING:
    from mavproxy_fault.fault_parts.fault import Outgoing
    from mavproxy_fault.wire.label import Label

NEVER_US = 1 << 62


@dataclass(slots=True)
class LinkState:
    """What the core counts per link, by where frames came in."""

    frames: int = 0
    junk: int = 0
    faulted: int = 0  # frames that were changed, delayed, multiplied or dropped
    gaps: int = 0  # frames missing by their sequence numbers
    loops: int = 0
    unconfirmed: int = 0  # stamps that leapt and were not followed
    bad_signatures: int = 0


class Arrival(NamedTuple):
    """Where and when some input came."""

    link: int
    direction: Direction
    now_us: int


class Core:
    """The proxy's state between its links."""

    def __init__(
        self,
        links: Sequence[LinkRole],
        engine: FaultEngine | None = None,
        *,
        signing: Signing | None = None,
        control: CommandResponder | None = None,
        tape: CaptureBuffer | None = None,
    ) -> None:
        self.links = tuple(links)
        self.engine = engine
        self.control = control
        self.senders = new_senders()
        self.clock = VehicleClock(self.senders)
        self.states = [LinkState() for _ in links]
        self._signing = signing
        self._capture = tape
        self._routes = Routes(len(self.links), self.senders)
        self._guard = LoopGuard()
        self._numbering = Numbering(self.senders)
        self._labels: list[Label] = []
        self._parsers: dict[tuple[int, int], Parser] = {}
        self._ended = [ParserCounters() for _ in links]
        self._resync_deadlines: dict[tuple[int, int], ResyncDeadline] = {}
        self._give_up_us: dict[tuple[int, int], int] = {}  # streams that owe the rest of a frame
        self._pending: list[tuple[int, int, int, bytes]] = []  # due, order, links, bytes
        self._order = itertools.count()
        self.last_due_us = 0  # when what left last was due; nothing may come before that any more
        self._on_wall_clock = False
        self._doubted = 0  # stamps, on all links
        self._numbers: dict[int, list[int]] = {}  # links by mask, for the few masks that occur
        # As a mask: one number says to which links something goes.
        self._listeners = sum(
            1 << number for number, role in enumerate(links) if role.direction == "to-vehicle"
        )

    # What comes in

    def received(
        self,
        link: int,
        data: bytes,
        now_us: int,
        *,
        stream: int = 0,
        direction: Direction | None = None,
    ) -> list[Send]:
        """What to send for bytes that came; empty bytes end their stream.

        `direction` overrides the link's, for a log that holds both.
        """
        # What was due before leaves first: the order depends on stamps alone. No frame is given up:
        # the rest may be among what is read at the same time.
        sends = self._release_due(now_us)
        role = self.links[link]
        key = (link, stream)
        parser = self._parsers.get(key)
        if parser is None:
            parser = self._parsers[key] = Parser()
        if data:
            items = parser.push(data, datagram=role.datagrams)
        else:
            items = parser.release()
            self._ended[link].add(parser.counters)
            del self._parsers[key]
            self._resync_deadlines.pop(key, None)
            self._give_up_us.pop(key, None)
        if data and not role.datagrams:
            self._resync_deadlines.setdefault(key, ResyncDeadline()).note_arrival(len(data), now_us)
            self._wait_for_rest(key)
        arrival = Arrival(link, direction or role.direction, now_us)
        return sends + self._process(items, arrival)

    def received_frame(self, link: int, frame: Frame, now_us: int) -> list[Send]:
        """What to send for a frame that somebody has verified already."""
        arrival = Arrival(link, self.links[link].direction, now_us)
        return self.due(now_us) + self._process((frame,), arrival)

    def due(self, now_us: int) -> list[Send]:
        """What falls due by `now_us`, in order; bytes last of which no frame comes any more."""
        sends = self._release_due(now_us)
        for key in list(self._give_up_us):
            # The rest of the frame will not come: the bytes leave as they are.
            while self._give_up_us.get(key, NEVER_US) <= now_us:
                arrival = Arrival(key[0], self.links[key[0]].direction, now_us)
                sends += self._process(self._parsers[key].resync(), arrival)
                self._wait_for_rest(key)
        return sends

    def links_to_resync(self, now_us: int) -> set[int]:
        """The links with streams whose incomplete frames `due` gives up by `now_us`."""
        return {link for (link, _), due_us in self._give_up_us.items() if due_us <= now_us}

    def _release_due(self, now_us: int) -> list[Send]:
        """What was kept for a time that has come, in order."""
        sends: list[Send] = []
        while self._pending or self.engine is not None:
            engine_us = self._engine_due_us()
            pending_us = self._pending[0][0] if self._pending else NEVER_US
            if min(engine_us, pending_us) > now_us:
                break
            # A clock that leapt ahead would let what is kept leave long before it came.
            when_us = max(min(engine_us, pending_us), self.last_due_us)
            self.last_due_us = when_us
            if pending_us <= engine_us:
                _, _, mask, raw = heapq.heappop(self._pending)
                self._record(raw, when_us)
                sends += self._to_links(mask, raw, when_us)
            else:
                sends += self._release_from_engine(when_us)
        return sends

    def _wait_for_rest(self, key: tuple[int, int]) -> None:
        """Note until when a stream may owe the rest of a frame, if it does."""
        due_us = self._resync_deadlines[key].due_us(self._parsers[key])
        self._give_up_us.pop(key, None)
        if due_us is not None:
            self._give_up_us[key] = due_us

    @property
    def next_due_us(self) -> int | None:
        """Wall time at which `due` has something to do; None if nothing waits."""
        # The earliest of faults, delayed frames and broken-off streams.
        when_us = self._engine_due_us()
        if self._pending:
            when_us = min(when_us, self._pending[0][0])
        if self._give_up_us:
            when_us = min(when_us, *self._give_up_us.values())
        return None if when_us >= NEVER_US else when_us

    def finish(self, now_us: int) -> list[Send]:
        """End every fault; what is still delayed stays unsent."""
        sends = self.due(now_us)
        if self.engine is not None:
            departures: OutgoingBatch = []
            labels = [*self.engine.drain_labels(), *self.engine.finish(self.clock.t_us)]
            self._announce(labels, now_us, departures)
            sends += self._sends(departures, now_us) + self.due(now_us)
        return sends

    def gaps(self) -> dict[tuple[int, int], int]:
        """Frames missing by their sequence numbers, per system and component."""
        missing = self.senders[GAPS : GAPS + SENDERS]
        # System in the upper byte, component in the lower.
        return {(n >> 8, n & 0xFF): count for n, count in enumerate(missing) if count}

    def drain_labels(self) -> "list[Label]":
        """Labels begun or ended since the last call."""
        labels, self._labels = self._labels, []
        return labels

    def parser_counters(self, link: int) -> ParserCounters:
        """What the parsers of one link have counted, of streams that ended too."""
        # A copy: the counters of streams that ended stay as they are.
        total = dataclasses.replace(self._ended[link])
        for (number, _), parser in self._parsers.items():
            if number == link:
                total.add(parser.counters)
        return total

    # Input

    def _process(self, items: Iterable[Frame | Junk], arrival: Arrival) -> list[Send]:
        departures: OutgoingBatch = []
        for item in items:
            is_frame = isinstance(item, Frame)
            if self._capture is not None:
                self._capture.receive(arrival.now_us, arrival.link, item.raw, is_frame=is_frame)
            if isinstance(item, Frame):
                self._frame(item, arrival, departures)
            else:
                self._junk(item, arrival, departures)
        # What came in one datagram leaves in one.
        if self.links[arrival.link].datagrams and len(departures) > 1:
            departures = join_datagrams(departures)
        return self._sends(departures, arrival.now_us)

    def _frame(self, frame: Frame, arrival: Arrival, departures: OutgoingBatch) -> None:
        state = self.states[arrival.link]
        state.frames += 1
        if not self._admit(frame, arrival):
            state.loops += 1
            return
        t_us = self._time(frame, arrival.now_us, state, departures)
        control = self.control
        if control is not None and frame.id in control.wanted:
            replies = control.consume(frame, t_us)
            if replies is not None:
                for reply in replies:
                    raw = self._numbering.number_frame(reply)
                    self._send_now(1 << arrival.link, raw, arrival.now_us, departures)
                return
        sealed = frame.signed
        if sealed and self._signing is not None:
            frame, sealed = self._signing.verify_incoming(frame)
            state.bad_signatures += sealed
        mask = self._routes.select(frame, arrival.link)
        engine = self.engine
        # Most frames are wanted by no fault and cost no more than this.
        if engine is None or (engine.wanted is not None and frame.id not in engine.wanted):
            self._send_now(mask, frame.raw, arrival.now_us, departures)
            return
        outgoing = engine.apply(frame, arrival.direction, t_us, sealed=sealed)
        if len(outgoing) != 1 or outgoing[0].frame is not frame or outgoing[0].due_us > t_us:
            state.faulted += 1
        for departure in outgoing:
            links = 1 << arrival.link if departure.back else mask
            self._emit(departure, frame, links, arrival.now_us - t_us, arrival.now_us, departures)
        self._announce(engine.drain_labels(), arrival.now_us, departures)

    def _junk(self, junk: Junk, arrival: Arrival, departures: OutgoingBatch) -> None:
        self.states[arrival.link].junk += 1
        mask = self._routes.all_links & ~(1 << arrival.link)
        now_us = arrival.now_us
        if self.engine is None:
            self._send_now(mask, junk.raw, now_us, departures)
            return
        t_us = self.clock.t_us if self.clock.t0_us is not None else now_us
        for departure in self.engine.junk(junk.raw, arrival.direction, t_us):
            self._emit(departure, None, mask, now_us - t_us, now_us, departures)
        self._announce(self.engine.drain_labels(), now_us, departures)

    def _admit(self, frame: Frame, arrival: Arrival) -> bool:
        """Learn the sender and count its gaps; False if the frame came round in a loop."""
        system, component, link = frame.system, frame.component, arrival.link
        if self._routes.note_sender(system, component, link):
            from_home = self._routes.home_links[system, component] == link
            if not self._guard.admits(frame.raw, from_home=from_home, now_us=arrival.now_us):
                return False
        sender = system << 8 | component
        # Who speaks on several links, as PX4 does, numbers the frames of each by itself.
        if self.senders[LINKS + sender] == 1 << link:
            self.states[link].gaps += missing_before(self.senders, sender, frame.seq)
        if arrival.direction == "from-vehicle":
            self.senders[VEHICLE_SYSTEM] = system
        return True

    def _time(self, frame: Frame, now_us: int, state: LinkState, departures: OutgoingBatch) -> int:
        senders = self.senders
        t_us = self.clock.read(frame, now_us)
        if senders[UNCONFIRMED] != self._doubted:
            self._doubted = senders[UNCONFIRMED]
            state.unconfirmed += 1
        if senders[T0] == UNKNOWN:
            self._on_wall_clock = True
        elif self._on_wall_clock:
            # The first stamp ever: the schedule, begun on the wall clock, begins on this one anew.
            self._on_wall_clock = False
            if self.engine is not None:
                senders[WALL_OFFSET] = now_us - t_us
                self.engine.restart(t_us)
                self._announce(self.engine.drain_labels(), now_us, departures)
        senders[WALL_OFFSET] = now_us - t_us
        return t_us

    # What leaves

    def _emit(
        self,
        outgoing: "Outgoing",
        origin: Frame | None,
        mask: int,
        lead_us: int,
        now_us: int,
        departures: OutgoingBatch,
    ) -> None:
        """Send or keep what the engine gave back for `origin`, which may be an earlier frame."""
        frame = outgoing.frame
        raw = frame if isinstance(frame, bytes) else frame.raw
        if origin is not None and frame is not origin and source_of(frame) != source_of(origin):
            # What goes back reaches where its cause came from, whoever else signs as it does there.
            mask = self._links_of_pending(frame) | (mask if outgoing.back else 0)
        if isinstance(frame, Frame) and frame.signed and frame is not origin and self._signing:
            raw = self._signing.sign_outgoing(frame).raw
        if outgoing.back and isinstance(frame, Frame):  # the proxy's own word to a simulator
            raw = self._numbering.number_frame(frame)
        due_us = outgoing.due_us + lead_us
        if due_us <= now_us:
            self._send_now(mask, raw, now_us, departures)
        else:
            heapq.heappush(self._pending, (due_us, next(self._order), mask, raw))

    def _send_now(self, mask: int, raw: bytes, now_us: int, departures: OutgoingBatch) -> None:
        if mask:
            self._record(raw, now_us)
            departures.append((mask, raw))

    def _record(self, raw: bytes, when_us: int) -> None:
        if self._capture is not None:
            self._capture.send(when_us, raw)
        if self.control is not None:
            self.control.sent(raw, when_us - self.senders[WALL_OFFSET])

    def _announce(self, labels: "list[Label]", now_us: int, departures: OutgoingBatch) -> None:
        for label in labels:
            self._labels.append(label)
            self._send_now(
                self._listeners,
                self._numbering.number_frame(
                    label_announcement(label, self.senders[VEHICLE_SYSTEM])
                ),
                now_us,
                departures,
            )

    def _sends(self, departures: OutgoingBatch, when_us: int) -> list[Send]:
        return [send for mask, data in departures for send in self._to_links(mask, data, when_us)]

    def _to_links(self, mask: int, data: bytes, when_us: int) -> list[Send]:
        numbers = self._numbers.get(mask)
        if numbers is None:
            numbers = [number for number in range(len(self.links)) if mask >> number & 1]
            self._numbers[mask] = numbers
        return [Send(number, data, when_us) for number in numbers]

    # What the engine holds

    def _engine_due_us(self) -> int:
        release_us = None if self.engine is None else self.engine.release_us
        return NEVER_US if release_us is None else release_us + self.senders[WALL_OFFSET]

    def _release_from_engine(self, when_us: int) -> list[Send]:
        assert self.engine is not None
        departures: OutgoingBatch = []
        for outgoing in self.engine.due(when_us - self.senders[WALL_OFFSET]):
            mask = self._links_of_pending(outgoing.frame)
            if outgoing.back:  # to whom it went before, wherever that is
                mask = self._routes.all_links
            self._emit(outgoing, None, mask, self.senders[WALL_OFFSET], when_us, departures)
        self._announce(self.engine.drain_labels(), when_us, departures)
        return self._sends(departures, when_us)

    def _links_of_pending(self, frame: Frame | bytes) -> int:
        """Where a frame goes that was kept since some earlier time, by its sender's home link."""
        home = self._routes.home_links.get(source_of(frame))
        if home is None:
            return self._routes.all_links
        if isinstance(frame, Frame):
            return self._routes.select(frame, home)
        return self._routes.all_links & ~(1 << home)
