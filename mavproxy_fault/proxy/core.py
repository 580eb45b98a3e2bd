"""Core: the proxy without sockets, files or clocks.

Bytes of a link come in with their arrival time (wall clock); sends with due times come out. In
between every frame is verified, recorded, passed to the fault engine if it wants it, and routed.
Unchanged frames keep their bytes, and frames of one datagram leave in one datagram.

The output depends only on the input and its timestamps, never on when `due` is called, so a replay
with the same schedule gives the same bytes.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mavproxy_fault.proxy.announcements import label_announcement
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.delay_queue import LAST_DUE, DelayQueue, follow_simulator
from mavproxy_fault.proxy.interfaces import (
    NEVER_US,
    CommandResponder,
    Direction,
    LinkRole,
    Route,
    Send,
)
from mavproxy_fault.proxy.numbering import Numbering
from mavproxy_fault.proxy.outgoing_batch import OutgoingBatch, join_datagrams, source_of
from mavproxy_fault.proxy.resync_deadline import ResyncDeadline
from mavproxy_fault.proxy.routing import LoopGuard, Routes
from mavproxy_fault.proxy.sender_rules import link_time, missing_before
from mavproxy_fault.proxy.senders import (
    GAPS,
    LINK_TIME,
    LINKS,
    SENDERS,
    SIMULATED,
    T0,
    UNCONFIRMED,
    UNKNOWN,
    VEHICLE_SYSTEM,
    WALL_OFFSET,
    new_senders,
)
from mavproxy_fault.proxy.vehicle_clock import HIL_SENSOR, VehicleClock
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Junk, Parser, ParserCounters
from mavproxy_fault.wire.signing import Signing

if TYPE_CHECKING:  # a proxy without faults starts faster without them
    from mavproxy_fault.fault_parts.fault import Outgoing
    from mavproxy_fault.proxy.engine import Engine
    from mavproxy_fault.wire.label import Label

HEARTBEAT = message_layout("HEARTBEAT").id


@dataclass(slots=True)
class LinkState:
    """Counts of one link, of frames received on it."""

    frames: int = 0
    junk: int = 0
    faulted: int = 0  # frames that were changed, delayed, multiplied or dropped
    gaps: int = 0  # frames missing by their sequence numbers
    loops: int = 0
    unconfirmed: int = 0  # unconfirmed timestamps
    bad_signatures: int = 0


class Arrival(NamedTuple):
    """Link, direction and wall time of received data, and the vehicle time of a frame if known."""

    link: int
    direction: Direction
    now_us: int
    t_us: int | None = None


class Core:
    """The proxy's state: parsers, senders, routes, fault engine and frames not yet due."""

    def __init__(
        self,
        links: Sequence[LinkRole],
        engine: "Engine | None" = None,
        *,
        signing: Signing | None = None,
        control: CommandResponder | None = None,
        tape: CaptureBuffer | None = None,
    ) -> None:
        self.links = tuple(links)
        self.engine = engine
        self.senders = new_senders()
        self.control: CommandResponder | None = None
        if control is not None:
            self.attach(control)
        self.clock = VehicleClock(self.senders)
        self.states = [LinkState() for _ in links]
        self.signing = signing
        self._capture = tape
        vehicle_links = sum(
            1 << number for number, role in enumerate(links) if role.direction == "from-vehicle"
        )
        self._routes = Routes(len(self.links), self.senders, vehicle_links)
        self._guard = LoopGuard()
        self._numbering = Numbering(self.senders)
        self._labels: list[Label] = []
        self._parsers: dict[tuple[int, int], Parser] = {}
        self.parsed = [ParserCounters() for _ in links]  # by all parsers of each link
        self._resync_deadlines: dict[tuple[int, int], ResyncDeadline] = {}
        self._give_up_us: dict[tuple[int, int], int] = {}  # streams with an incomplete frame
        self.waiting = DelayQueue()
        self.release_delayed: Callable[[int], list[Send]] | None = None  # by machine code
        self._on_wall_clock = False
        self._doubted = 0  # timestamps, on all links
        self._frame_us = 0  # vehicle time of the frame in process
        self._numbers: dict[int, list[int]] = {}  # cache: link numbers by bit mask
        self._listeners = self._routes.all_links & ~vehicle_links  # that announcements go to

    def attach(self, control: CommandResponder) -> None:
        """Let a responder see commands and messages, and give it the core's table of senders."""
        control.senders = self.senders
        self.control = control

    # -- inputs ----------------------------------------------------------------------------------

    def received(
        self,
        link: int,
        data: bytes,
        now_us: int,
        *,
        stream: int = 0,
        begun: bool = False,
    ) -> list[Send]:
        """Process received bytes and return what to send; empty bytes end their stream.

        `begun` is true for the rest of a datagram or chunk whose first frames have passed.
        """
        # Earlier due frames leave first, so the order depends only on timestamps. No incomplete
        # frame is abandoned here: the rest may be in the same batch of reads.
        sends = [] if begun else self.release_due(now_us)
        role = self.links[link]
        key = (link, stream)
        parser = self._parsers.get(key)
        if parser is None:
            parser = self._parsers[key] = Parser(self.parsed[link])
        if data:
            items = parser.push(data, datagram=role.datagrams)
        else:
            items = parser.release()
            del self._parsers[key]
            self._resync_deadlines.pop(key, None)
            self._give_up_us.pop(key, None)
        if data and not role.datagrams:
            self._resync_deadlines.setdefault(key, ResyncDeadline()).note_arrival(len(data), now_us)
            self._wait_for_rest(key)
        return sends + self._process(items, Arrival(link, role.direction, now_us))

    def received_frame(self, link: int, frame: Frame, now_us: int, t_us: int | None) -> list[Send]:
        """Process a frame that is verified already, and timed unless `t_us` is None."""
        self.parsed[link].bytes += len(frame.raw)
        self.parsed[link].frames += 1
        return self._process((frame,), Arrival(link, self.links[link].direction, now_us, t_us))

    def due(self, now_us: int) -> list[Send]:
        """Return what is due by `now_us`, in order, and then abandoned incomplete frames."""
        sends = self.release_due(now_us)
        for key in list(self._give_up_us):
            # The rest of the frame is overdue: forward the bytes as junk.
            while self._give_up_us.get(key, NEVER_US) <= now_us:
                arrival = Arrival(key[0], self.links[key[0]].direction, now_us)
                sends += self._process(self._parsers[key].resync(), arrival)
                self._wait_for_rest(key)
        return sends

    def links_to_resync(self, now_us: int) -> set[int]:
        """Return the links with incomplete frames that `due` would abandon by `now_us`."""
        return {link for (link, _), due_us in self._give_up_us.items() if due_us <= now_us}

    def release_due(self, now_us: int) -> list[Send]:
        """Release delayed frames that are due, in order."""
        sends: list[Send] = []
        numbers = self.waiting.numbers
        while (due_us := min(self._engine_due_us(), self.waiting.first_us)) <= now_us:
            is_delayed = due_us == self.waiting.first_us
            if is_delayed and self.release_delayed and (some := self.release_delayed(now_us)):
                sends += some
                continue
            # After a time jump forward, a delayed frame could otherwise leave before it arrived.
            numbers[LAST_DUE] = when_us = max(due_us, numbers[LAST_DUE])
            if is_delayed:
                mask, raw = self.waiting.release()
                self._record(raw, when_us, when_us - self.senders[WALL_OFFSET])
                sends += self.to_links(mask, raw, when_us)
            else:
                sends += self._release_from_engine(when_us)
        return sends

    def _wait_for_rest(self, key: tuple[int, int]) -> None:
        """Set the deadline for the rest of a stream's incomplete frame, if there is one."""
        due_us = self._resync_deadlines[key].due_us(self._parsers[key])
        self._give_up_us.pop(key, None)
        if due_us is not None:
            self._give_up_us[key] = due_us

    @property
    def next_due_us(self) -> int | None:
        """Wall time at which `due` has work to do; None if nothing is waiting."""
        when_us = min(self.own_due_us, self.waiting.first_us)
        return None if when_us >= NEVER_US else when_us

    @property
    def own_due_us(self) -> int:
        """The same without delayed frames: of buffering faults and incomplete frames."""
        return min(self._engine_due_us(), *self._give_up_us.values(), NEVER_US)

    def finish(self, now_us: int) -> list[Send]:
        """End every fault and return the last sends; frames delayed further stay unsent."""
        sends = self.due(now_us)
        if self.engine is not None:
            batch: OutgoingBatch = []
            self.advance_link(now_us)
            labels = [*self.engine.drain_labels(), *self.engine.finish(self.clock.t_us)]
            self._announce(labels, now_us, batch)
            sends += self._sends(batch, now_us) + self.due(now_us)
        return sends

    def gaps(self) -> dict[tuple[int, int], int]:
        """Return the frames missing by sequence number, per system and component."""
        missing = self.senders[GAPS : GAPS + SENDERS]
        # System in the upper byte, component in the lower.
        return {(n >> 8, n & 0xFF): count for n, count in enumerate(missing) if count}

    def drain_labels(self) -> "list[Label]":
        """Return the labels begun or ended since the last call."""
        labels, self._labels = self._labels, []
        return labels

    # -- processing ------------------------------------------------------------------------------

    def _process(self, items: Iterable[Frame | Junk], arrival: Arrival) -> list[Send]:
        batch: OutgoingBatch = []
        for item in items:
            is_frame = isinstance(item, Frame)
            if self._capture is not None:
                self._capture.receive(arrival.now_us, arrival.link, item.raw, is_frame=is_frame)
            if isinstance(item, Frame):
                self._frame(item, arrival, batch)
            else:
                self._junk(item, arrival, batch)
        # Frames of one datagram leave in one.
        if self.links[arrival.link].datagrams and len(batch) > 1:
            batch = join_datagrams(batch)
        return self._sends(batch, arrival.now_us)

    def _frame(self, frame: Frame, arrival: Arrival, batch: OutgoingBatch) -> None:
        state = self.states[arrival.link]
        state.frames += 1
        if not self._admit(frame, arrival):
            state.loops += 1
            return
        t_us = self._time(frame, arrival, state, batch)
        sealed = frame.signed
        if sealed and self.signing is not None:
            frame, sealed = self.signing.verify_incoming(frame)
            state.bad_signatures += sealed
        control = self.control
        if control is not None and frame.id in control.wanted:
            if self.engine is not None:
                self.engine.link_us = self.senders[LINK_TIME]
            replies = control.consume(frame, arrival.direction, t_us, sealed=sealed)
            if replies is not None:
                for reply in replies:
                    raw = self._numbering.number_frame(reply)
                    self._send_now(1 << arrival.link, raw, arrival.now_us, batch)
                if frame.id != HEARTBEAT:  # which is for the vehicle too
                    return
        mask = self._routes.select(frame, arrival.link)
        engine = self.engine
        # Fast path: most frames are not wanted by any fault.
        if engine is None or (engine.wanted is not None and frame.id not in engine.wanted):
            self._send_now(mask, frame.raw, arrival.now_us, batch)
            return
        link_us = self.senders[LINK_TIME]
        route = Route(1 << arrival.link, mask, link_us)
        outgoing = engine.apply(frame, arrival.direction, t_us, route, sealed=sealed)
        if len(outgoing) != 1 or outgoing[0].frame is not frame or outgoing[0].due_us > link_us:
            state.faulted += 1
        for out in outgoing:
            links = 1 << arrival.link if out.back else mask
            self._emit(out, frame, links, arrival.now_us, batch)
        self._announce(engine.drain_labels(), arrival.now_us, batch)

    def _junk(self, junk: Junk, arrival: Arrival, batch: OutgoingBatch) -> None:
        state = self.states[arrival.link]
        state.junk += 1
        mask = self._routes.all_links & ~(1 << arrival.link)
        now_us = arrival.now_us
        frame, sealed = junk.frame(), False
        if frame is not None:
            # Its checksum proves little: only a frame with a correct one introduces a sender.
            known = self.senders[LINKS + (frame.system << 8 | frame.component)]
            if known and not self._admit(frame, arrival):
                state.loops += 1
                return
            sealed = frame.signed
            if sealed and self.signing is not None:
                frame, sealed = self.signing.verify_incoming(frame)
                state.bad_signatures += sealed
        raw = junk.raw if frame is None else frame.raw
        if self.engine is None:
            self._send_now(mask, raw, now_us, batch)
            return
        t_us = self._frame_us = self.clock.t_us if self.clock.t0_us is not None else now_us
        route = Route(1 << arrival.link, mask, self._note_link_time(now_us))
        whole = raw if frame is None else frame
        for out in self.engine.junk(whole, arrival.direction, t_us, route, sealed=sealed):
            self._emit(out, frame, mask, now_us, batch)
        self._announce(self.engine.drain_labels(), now_us, batch)

    def _admit(self, frame: Frame, arrival: Arrival) -> bool:
        """Record the sender and count its gaps; return False if the frame is in a loop."""
        system, component, link = frame.system, frame.component, arrival.link
        if self._routes.note_sender(system, component, link):
            from_home = self._routes.home_links[system, component] == link
            if not self._guard.admits(frame.raw, from_home=from_home, now_us=arrival.now_us):
                return False
        sender = system << 8 | component
        # A sender on several links, such as PX4, numbers the frames of each separately.
        if self.senders[LINKS + sender] == 1 << link:
            self.states[link].gaps += missing_before(self.senders, sender, frame.seq)
        if arrival.direction == "from-vehicle":
            self.senders[VEHICLE_SYSTEM] = system
        return True

    def _time(self, frame: Frame, arrival: Arrival, state: LinkState, batch: OutgoingBatch) -> int:
        senders, now_us = self.senders, arrival.now_us
        first_us = senders[T0]
        t_us = self.clock.read(frame, now_us) if arrival.t_us is None else arrival.t_us
        self._frame_us = t_us
        if senders[UNCONFIRMED] != self._doubted:
            self._doubted = senders[UNCONFIRMED]
            state.unconfirmed += 1
        if senders[T0] == UNKNOWN:
            self._on_wall_clock = True
        elif self._on_wall_clock or senders[T0] != first_us != UNKNOWN:
            # The timeline begins, after the wall clock or another clock: restart the schedule.
            self._on_wall_clock = False
            if self.engine is not None:
                senders[WALL_OFFSET] = now_us - t_us
                self.engine.restart(t_us)
                self._announce(self.engine.drain_labels(), now_us, batch)
        self._note_link_time(now_us)
        if frame.id == HIL_SENSOR:
            follow_simulator(self.waiting.numbers, t_us, now_us)
        return t_us

    def _note_link_time(self, now_us: int) -> int:
        link_us = self.senders[LINK_TIME] = link_time(self.senders, now_us)
        self.senders[WALL_OFFSET] = now_us - link_us
        return link_us

    def advance_link(self, now_us: int) -> None:
        """Advance the engine's link time for a live edit, even without a frame."""
        if self.engine is not None and self.engine.t0_us is not None:
            link_us = link_time(self.senders, now_us)
            self.engine.link_us = max(self.engine.link_us, link_us)

    # -- outputs ---------------------------------------------------------------------------------

    def _emit(
        self,
        outgoing: "Outgoing",
        origin: Frame | None,
        mask: int,
        now_us: int,
        batch: OutgoingBatch,
    ) -> None:
        """Send or delay a frame returned by the engine; `origin` is the frame it processed."""
        frame = outgoing.frame
        raw = frame if isinstance(frame, bytes) else frame.raw
        if (
            origin is not None
            and isinstance(frame, Frame)
            and source_of(frame) != source_of(origin)
        ):
            # A reply also goes to the link of its cause, whatever other links its sender has.
            mask = self._links_of_pending(frame) | (mask if outgoing.back else 0)
        if isinstance(frame, Frame) and frame.signed and frame is not origin and self.signing:
            raw = self.signing.sign_outgoing(frame).raw
        if outgoing.back and isinstance(frame, Frame):  # the proxy's own message to a simulator
            raw = self._numbering.number_frame(frame)
        mask &= outgoing.links
        due_us = outgoing.due_us + self.senders[WALL_OFFSET]
        if due_us <= now_us:
            self._send_now(mask, raw, now_us, batch)
        elif mask:
            self.waiting.hold(due_us, mask, raw)

    def _send_now(self, mask: int, raw: bytes, now_us: int, batch: OutgoingBatch) -> None:
        if mask:
            self._record(raw, now_us, self._frame_us)
            batch.append((mask, raw))

    def _record(self, raw: bytes, when_us: int, t_us: int) -> None:
        if self._capture is not None:
            self._capture.send(when_us, raw)
        if self.control is not None:
            self.control.sent(raw, t_us)

    def _announce(self, labels: "list[Label]", now_us: int, batch: OutgoingBatch) -> None:
        for label in labels:
            if label.clock and self.senders[SIMULATED]:  # a lockstep link's time is the vehicle's
                import msgspec  # a proxy without faults starts without it

                label = msgspec.structs.replace(label, clock="")
            self._labels.append(label)
            self._send_now(
                self._listeners,
                self._numbering.number_frame(
                    label_announcement(label, self.senders[VEHICLE_SYSTEM])
                ),
                now_us,
                batch,
            )

    def _sends(self, batch: OutgoingBatch, when_us: int) -> list[Send]:
        return [send for mask, data in batch for send in self.to_links(mask, data, when_us)]

    def announce_labels(self, now_us: int) -> list[Send]:
        """Return the announcements of the labels that the engine has begun or ended."""
        batch: OutgoingBatch = []
        if self.engine is not None:
            self._announce(self.engine.drain_labels(), now_us, batch)
        return self._sends(batch, now_us)

    def take_incomplete(self, link: int, stream: int) -> bytes:
        """Return and forget the bytes of a stream that wait for the rest of their frame."""
        if not self.is_incomplete(link, stream):
            return b""
        self._give_up_us.pop((link, stream), None)
        return self._parsers[link, stream].take_incomplete()

    def is_incomplete(self, link: int, stream: int) -> bool:
        """Whether bytes of a stream wait for the rest of their frame."""
        parser = self._parsers.get((link, stream))
        return parser is not None and parser.incomplete > 0

    def to_links(self, mask: int, data: bytes, when_us: int) -> list[Send]:
        """Return the sends of the same bytes to several links, a bit mask."""
        numbers = self._numbers.get(mask)
        if numbers is None:
            numbers = [number for number in range(len(self.links)) if mask >> number & 1]
            self._numbers[mask] = numbers
        return [Send(number, data, when_us) for number in numbers]

    # -- frames buffered by the engine -----------------------------------------------------------

    def _engine_due_us(self) -> int:
        release_us = None if self.engine is None else self.engine.release_us
        return NEVER_US if release_us is None else release_us + self.senders[WALL_OFFSET]

    def _release_from_engine(self, when_us: int) -> list[Send]:
        assert self.engine is not None
        batch: OutgoingBatch = []
        self._frame_us = when_us - self.senders[WALL_OFFSET]
        for outgoing in self.engine.due(self._frame_us):
            mask = self._links_of_pending(outgoing.frame)
            if outgoing.back:  # to all links, as the earlier ones may have gone anywhere
                mask = self._routes.all_links
            self._emit(outgoing, None, mask, when_us, batch)
        self._announce(self.engine.drain_labels(), when_us, batch)
        return self._sends(batch, when_us)

    def _links_of_pending(self, frame: Frame | bytes) -> int:
        """Select the links for a buffered frame, by its sender's home link."""
        home = self._routes.home_links.get(source_of(frame))
        if home is None:
            return self._routes.all_links
        if isinstance(frame, Frame):
            return self._routes.select(frame, home)
        return self._routes.all_links & ~(1 << home)
