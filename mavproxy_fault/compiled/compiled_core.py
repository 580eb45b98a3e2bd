"""The core with machine code in front of it: what that cannot process, the core does, in order.

This module gives the machine code its arrays, decides for each message whether that may process it
(the control path must not need it, and its faults must have rules), and returns to the core what
was counted. It needs no sockets; `forwarder` adds those.
"""

from array import array
from contextlib import suppress
from ctypes import CDLL, c_void_p, cast
from typing import TYPE_CHECKING, Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.object_file import load
from mavproxy_fault.fault_parts.elements import instance_element
from mavproxy_fault.proxy.capture_buffer import INDEX, CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import NEVER_US, Send
from mavproxy_fault.proxy.routing import target_offsets
from mavproxy_fault.proxy.senders import UNKNOWN, WALL_OFFSET
from mavproxy_fault.proxy.vehicle_clock import stamp_location
from mavproxy_fault.wire.dialect import Layout, find_layout
from mavproxy_fault.wire.frame import Frame, frame_header
from mavproxy_fault.wire.parser import walk_frames
from mavproxy_fault.wire.signing import SETUP_SIGNING, Signing

if TYPE_CHECKING:
    from mavproxy_fault.compiled.plans import Plans
COUNTS = {
    k.FRAMES: "frames", k.MISSING: "gaps", k.FAULTED: "faulted", k.BAD_SIGNATURES: "bad_signatures",
}  # fmt: skip
OTHER_HEAD = 10  # bytes of length and time before what is no frame


def sha256_addresses() -> list[int]:
    """The addresses of OpenSSL's functions, by the library that Python has loaded or the system's;
    zeros if there is none."""
    import _hashlib

    for name in (getattr(_hashlib, "__file__", ""), "libcrypto.so.3", "libcrypto.so.1.1"):
        with suppress(OSError, AttributeError):
            found = (CDLL(name)[f"SHA256_{part}"] for part in ("Init", "Update", "Final"))
            return [cast(one, c_void_p).value or 0 for one in found]
    return [0, 0, 0]


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
            streams=signing.streams, waiting=core.waiting.numbers,
            delayed=core.waiting.frames,
        )  # fmt: skip
        self._addresses = (c_void_p * len(self.shared))(*map(k.address, self.shared))
        key = signing.key or b""
        self.shared.key[: len(key)] = key
        self.loop, self.ports = self.shared.loop, self.shared.ports
        self._learned: dict[int, Layout] = {}
        self._plans: Plans | None = None
        self.loop[k.KEEP], self.loop[k.WANTED_AT] = tape is not None, UNKNOWN
        self.loop[k.ENGINE_DUE] = NEVER_US
        self.loop[k.LINK_COUNT], self.loop[k.POLLS] = len(core.links), descriptors
        self.loop[k.SIGNING] = k.KEYED * bool(key) | k.STRIPPED * signing.strip
        if key:
            self.loop[k.SHA_INIT : k.SHA_FINAL + 1] = array("q", sha256_addresses())
        for number, role in enumerate(core.links):
            self.ports[number, k.FROM_VEHICLE] = role.direction == "from-vehicle"
            self.loop[k.SEPARATE] |= role.datagrams << number
        core.release_delayed = self._release
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
        places = stamp_location(described.name)
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
        self._follow_engine()
        self._core_ran = False

    def _follow_engine(self) -> None:
        """Note when the core has to see a frame, or to release some."""
        engine: Any = self._core.engine
        if engine is not None:
            self.loop[k.EDGE], self.loop[k.LINK_EDGE] = engine.edges_us
            release_us = engine.release_us
            self.loop[k.ENGINE_DUE] = NEVER_US if release_us is None else release_us

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
        if self._plans is None:  # imported at first use
            from mavproxy_fault.compiled.plans import Plans

            self._plans = Plans(self.shared)
        first = self._plans.add(self._learned[number], acting)
        return (k.INTERPRETED, -1) if first is None else (k.PLANNED, first)

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
            at, found = at + self.loop[k.ROW_AT], self.loop[k.FOUND]
            sends += self._segments(-1)
            self._settle(now_us, news=found == k.NEWS)
            sends += self.take_sends()
            if found in (k.FRAME, k.REST):
                more, taken = self._give(link, data[at:], now_us, stream, found, begun=at > 0)
                sends += more
                at += taken
            if at >= len(data):
                return sends
            self._lend(link, data[at:], now_us)

    def _give(
        self, link: int, data: bytes, now_us: int, stream: int, found: int, *, begun: bool
    ) -> tuple[list[Send], int]:
        """Let the core take a verified frame, or what follows the frames that have passed."""
        self._core_ran = True
        _, number, length = frame_header(data, 0, len(data))
        if found == k.FRAME and number in self._learned:
            frame = Frame(data[:length], self._learned[number])
            t_us = None if self.loop[k.TIMED] == UNKNOWN else int(self.loop[k.TIMED])
            sends = [] if begun else self._core.release_due(now_us)
            return sends + self._core.received_frame(link, frame, now_us, t_us), length
        self._learn(data)
        return self._core.received(link, data, now_us, stream=stream, begun=begun), len(data)

    def _lend(self, link: int, data: bytes, now_us: int) -> None:
        """Pass a chunk in machine code, as far as that goes."""
        loop, length = self.loop, min(len(data), k.ROW)
        self.shared.data[:length] = data[:length]
        self._refresh()
        loop[k.LENT], loop[k.LINK], loop[k.CAME] = length, link, now_us * 1000 - loop[k.BASE]
        self._forward(self._addresses)

    def _release(self, now_us: int) -> list[Send]:
        """Release delayed frames that are due, up to one of the core's."""
        self._follow_engine()
        self.loop[k.RELEASE] = now_us
        self._forward(self._addresses)
        sends = self._segments(-1)
        self._settle(now_us)
        return sends

    def _segments(self, links: int) -> list[Send]:
        """What leaves of a chunk on some links, a bit mask."""
        found, at, segments = [], 0, self.shared.segments
        for segment in range(self.loop[k.SEGMENT]):
            length = segments[segment, k.BYTES_OUT]
            data = bytes(self.shared.outs[at : at + length])
            mask, due_us = segments[segment, k.LINKS] & links, segments[segment, k.DUE_US]
            found += self._core.to_links(mask, data, due_us)
            at += length
        return found

    # What was done

    def count(self) -> None:
        """Add the machine code's counts to the core's."""
        self._settle(self._core.clock.t_us + self._core.senders[WALL_OFFSET])
        ports = self.ports
        for number, state in enumerate(self._core.states):
            for column, name in COUNTS.items():
                setattr(state, name, getattr(state, name) + ports[number, column])
                ports[number, column] = 0

    def _settle(self, now_us: int, *, news: bool = False) -> None:
        """Give the core the times and the passed frames.

        With `news` a label has begun.
        """
        loop, core = self.loop, self._core
        engine: Any = core.engine
        if engine is not None and loop[k.WANTED_AT] != UNKNOWN:
            engine.now_us = int(loop[k.WANTED_AT])  # even if an older clock's, as in the core
            engine.link_us = int(loop[k.WANTED_LINK_AT])
            loop[k.WANTED_AT] = UNKNOWN
        if loop[k.SAMPLES_AT] and core.control is not None:
            core.control.note_samples(bytes(self.shared.sampled[: loop[k.SAMPLES_AT]]))
        loop[k.SAMPLES_AT] = 0
        if self._tape is not None and (loop[k.RECEIVED_AT] or loop[k.SENT_AT] or loop[k.OTHER_AT]):
            self._tape.received += self.shared.received[: loop[k.RECEIVED_AT]]
            self._tape.sent += self.shared.sent[: loop[k.SENT_AT]]
            self._tape.index += self.shared.index[: loop[k.INDEX_AT]]
            other, at = self.shared.other, 0
            while at < loop[k.OTHER_AT]:
                end = at + OTHER_HEAD + (other[at] << 8 | other[at + 1])
                when_us = int.from_bytes(other[at + 2 : at + OTHER_HEAD])
                self._tape.send(when_us, bytes(other[at + OTHER_HEAD : end]))
                at = end
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
        loop[k.RECEIVED_AT] = loop[k.SENT_AT] = loop[k.INDEX_AT] = loop[k.OTHER_AT] = 0
        return records
