"""The core with machine code in front of it: what that cannot process, the core does, in order.

This module gives the machine code its arrays, decides for each message whether that may process it
(the control path must not need it, and its faults must have rules), and returns to the core what
was counted. It needs no sockets; `forwarder` adds those.
"""

import struct
from ctypes import c_void_p
from typing import TYPE_CHECKING, Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.object_file import load
from mavproxy_fault.fault_parts.elements import instance_element
from mavproxy_fault.proxy.capture_buffer import INDEX, CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.proxy.routing import target_offsets
from mavproxy_fault.proxy.senders import UNKNOWN, WALL_OFFSET
from mavproxy_fault.proxy.vehicle_clock import stamp_location
from mavproxy_fault.wire.dialect import Layout, find_layout
from mavproxy_fault.wire.parser import frame_span, walk_frames
from mavproxy_fault.wire.signing import SETUP_SIGNING, Signing

if TYPE_CHECKING:
    from mavproxy_fault.compiled.plans import Plans

HELD = struct.Struct("<qqq")  # due time, links and length of a delayed frame


class CompiledCore:
    """Processes received bytes; `core.senders` and the faults' memory are shared with the core.

    With `tape` it records what it passes, as the core does.
    """

    def __init__(self, core: Core, descriptors: int, tape: CaptureBuffer | None) -> None:
        forward = load()
        assert forward is not None
        self._forward = forward
        self._core = core
        self._tape = tape
        signing = core.signing or Signing()
        self.shared = k.new_shared(
            len(core.links), descriptors, keep=tape is not None, senders=core.senders,
            streams=signing.verifier.streams,
        )  # fmt: skip
        self._addresses = (c_void_p * len(self.shared))(*map(k.address, self.shared))
        key = signing.key or b""
        self.shared.message[: len(key)] = key
        self.loop, self.ports = self.shared.loop, self.shared.ports
        self._learned: dict[int, Layout] = {}
        self._plans: Plans | None = None
        self.loop[k.KEEP], self.loop[k.WANTED_AT] = tape is not None, UNKNOWN
        self.loop[k.LINK_COUNT], self.loop[k.POLLS] = len(core.links), descriptors
        self.loop[k.SIGNING] = k.KEYED * bool(key) | k.STRIPPED * signing.strip
        for number, role in enumerate(core.links):
            self.ports[number, k.FROM_VEHICLE] = role.direction == "from-vehicle"
        self._core_ran = True  # since the rows of faults were last compared with the entries
        self._sends: list[Send] = []  # announcements, to be sent before anything else
        self._seen: tuple[Any, ...] = ()

    # What may be carried out

    def _learn(self, data: bytes) -> None:
        """Learn the messages of a datagram that are new."""
        for _, _, number in walk_frames(data):
            described = find_layout(number) if number < k.IDS else None
            if described is not None and number not in self._learned:
                self._learned[number] = described
                self._describe(number, described)
                self._classify(number)

    def _describe(self, number: int, described: Layout) -> None:
        places = stamp_location(described.name) or (-1, 0, 0)
        instance = instance_element(number)
        at, size = (instance[0].start, instance[0].end - instance[0].start) if instance else (-1, 0)
        values = (described.crc_extra, *places, *target_offsets(described.name), at, size)
        for column, value in zip(range(k.EXTRA, k.CHAIN), values, strict=True):
            self.shared.table[number, column] = value

    def _refresh(self) -> None:
        """Follow the engine and the control path."""
        engine: Any = self._core.engine
        control = self._core.control
        seen: tuple[Any, ...] = (control and control.wanted,)
        if engine is not None:
            seen += (engine.changes, engine.revision, engine.t0_us)
        plans = self._plans
        if seen != self._seen or (self._core_ran and plans is not None and plans.changed):
            if plans is not None:
                plans.clear()
            for number in self._learned:
                self._classify(number)
            self._seen = seen  # only now: what fails for want of memory is done again
        if plans is not None and self._core_ran:
            plans.follow_idle()
        if engine is not None:
            self.loop[k.EDGE], self.loop[k.LINK_EDGE] = engine.edges_us
        self._core_ran = False

    def _classify(self, number: int) -> None:
        """Set how a message is processed."""
        kind, first = self._way(number)
        control = self._core.control
        sampled = control is not None and number in control.wanted
        self.shared.table[number, k.SAMPLED] = sampled
        if self._plans is not None:
            self.loop[k.KEY_COUNT] = self._plans.key_count
        self.shared.table[number, k.KIND], self.shared.table[number, k.CHAIN] = kind, first

    def _way(self, number: int) -> tuple[int, int]:
        """The kind of a message, and the first row of its faults."""
        engine: Any = self._core.engine
        control = self._core.control
        # A signing key is routed and recorded with care.
        if number == SETUP_SIGNING or (control is not None and number in control.needed):
            return k.INTERPRETED, -1
        if engine is None or (engine.wanted is not None and number not in engine.wanted):
            return k.PASS, -1
        acting = None if engine.t0_us is None else engine.active_entries(number)
        if acting is None:
            return k.INTERPRETED, -1
        if not acting:
            return k.PASS_UNTIL_EDGE, -1
        first = self._planned().add(self._learned[number], acting)
        return (k.INTERPRETED, -1) if first is None else (k.PLANNED, first)

    def _planned(self) -> "Plans":
        """The rows of faults, created at first use."""
        if self._plans is None:
            from mavproxy_fault.compiled.plans import Plans

            self._plans = Plans(self.shared)
        return self._plans

    # Chunks without a socket

    def received(self, link: int, data: bytes, now_us: int, *, stream: int = 0) -> list[Send]:
        """Process received bytes as `Core.received` does; the core takes what needs it."""
        core = self._core
        if not data:
            return core.received(link, data, now_us, stream=stream)  # the end of a stream
        data = core.take_incomplete(link, stream) + data
        sends = core.release_due(now_us)
        self._lend(link, data, now_us)
        return sends + self.finish(link, data, now_us, stream=stream)

    def finish(self, link: int, data: bytes, now_us: int, *, stream: int = 0) -> list[Send]:
        """Return what leaves of a chunk that machine code has begun with."""
        sends: list[Send] = []
        at = 0
        while True:
            more, passed, found = self._collect(now_us)
            sends += more
            at += passed
            if found in (k.FRAME, k.REST):
                length = frame_length(data, at) if found == k.FRAME else len(data) - at
                sends += self._give(link, data[at : at + length], now_us, stream, begun=at > 0)
                at += length
            if at >= len(data):
                return sends
            self._lend(link, data[at:], now_us)

    def _give(
        self, link: int, data: bytes, now_us: int, stream: int = 0, *, begun: bool
    ) -> list[Send]:
        """Let the core take a frame or the rest of a datagram, of which a part may have passed."""
        self._learn(data)
        self._core_ran = True
        receive = self._core.received_rest if begun else self._core.received
        return receive(link, data, now_us, stream=stream)

    def _lend(self, link: int, data: bytes, now_us: int) -> None:
        """Pass a chunk in machine code, as far as that goes."""
        loop, length = self.loop, min(len(data), k.ROW)
        self.shared.data[:length] = data[:length]
        self._refresh()
        loop[k.LENT], loop[k.LINK], loop[k.CAME] = length, link, now_us * 1000 - loop[k.BASE]
        self._forward(self._addresses)

    def _collect(self, now_us: int) -> tuple[list[Send], int, int]:
        """Return what leaves of a chunk, how many bytes passed, and what ended it."""
        passed, found = self.loop[k.ROW_AT], self.loop[k.FOUND]
        sends = self._segments(-1, now_us)
        self._settle(now_us, news=found == k.NEWS)
        return sends + self.take_sends(), passed, found

    def _segments(self, links: int, now_us: int) -> list[Send]:
        """What leaves of a chunk on some links, a bit mask."""
        found, at, segments = [], 0, self.shared.segments
        for segment in range(self.loop[k.SEGMENT]):
            length = segments[segment, k.BYTES_OUT]
            data = bytes(self.shared.outs[at : at + length])
            found += self._core.to_links(segments[segment, k.LINKS] & links, data, now_us)
            at += length
        return found

    # What was done

    def count(self) -> None:
        """Add the machine code's counts to the core's."""
        self._settle(self._core.clock.t_us + self._core.senders[WALL_OFFSET])
        ports = self.ports
        for number, state in enumerate(self._core.states):
            state.frames += ports[number, k.FRAMES]
            state.gaps += ports[number, k.MISSING]
            state.faulted += ports[number, k.FAULTED]
            state.bad_signatures += ports[number, k.BAD_SIGNATURES]
            for column in (k.FRAMES, k.MISSING, k.FAULTED, k.BAD_SIGNATURES):
                ports[number, column] = 0

    def _settle(self, now_us: int, *, news: bool = False) -> None:
        """Give the core the times, the delayed frames and the passed ones.

        With `news` a label has begun.
        """
        loop, core = self.loop, self._core
        engine: Any = core.engine
        if engine is not None and loop[k.WANTED_AT] != UNKNOWN:
            engine.now_us = int(loop[k.WANTED_AT])  # even if an older clock's, as in the core
            engine.link_us = int(loop[k.WANTED_LINK_AT])
            loop[k.WANTED_AT] = UNKNOWN
        at = 0
        while at < loop[k.HELD_AT]:
            due_us, mask, length = HELD.unpack_from(self.shared.held, at)
            at += k.HELD_HEAD
            core.hold(due_us, mask, bytes(self.shared.held[at : at + length]))
            at += length
        loop[k.HELD_AT] = 0
        if self._tape is not None and loop[k.RECEIVED_AT]:
            self._tape.received += self.shared.received[: loop[k.RECEIVED_AT]]
            self._tape.sent += self.shared.sent[: loop[k.SENT_AT]]
            self._tape.index += self.shared.index[: loop[k.INDEX_AT]]
            self.drop_tape()
        if news:  # behind the frame that began it
            self._core_ran = True
            engine.attend_begun()
            self._sends += core.announce_labels(now_us)

    def take_sends(self) -> list[Send]:
        """Return the announcements to be sent now."""
        sends, self._sends = self._sends, []
        return sends

    def drop_tape(self) -> int:
        """Discard the machine code's record of the traffic; return the number of records."""
        loop = self.loop
        records = int(loop[k.INDEX_AT]) // INDEX.size
        loop[k.RECEIVED_AT] = loop[k.SENT_AT] = loop[k.INDEX_AT] = 0
        return records


def frame_length(data: bytes, at: int) -> int:
    """Return the length of the frame at a place, which is complete."""
    place = frame_span(data, at)
    assert place is not None
    return place[0]
