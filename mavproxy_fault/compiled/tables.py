"""The compiled form's arrays, the messages that it may process, and the counts that it returns.

This module decides for each message whether compiled code may process it: the control path must
not need it, and its faults must be expressible as `plans`. All other datagrams are processed by
the interpreter, in order.
"""

from ctypes import c_void_p
from typing import TYPE_CHECKING, Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.object_file import load
from mavproxy_fault.proxy.capture_buffer import INDEX, CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.routing import target_offsets
from mavproxy_fault.proxy.vehicle_clock import stamp_location
from mavproxy_fault.wire.dialect import Layout, find_layout
from mavproxy_fault.wire.signing import SETUP_SIGNING

if TYPE_CHECKING:
    from mavproxy_fault.compiled.plans import Plans


class Tables:
    """Arrays that the machine code works on; `core.senders` is shared with the interpreted way."""

    def __init__(self, core: Core, descriptors: int, tape: CaptureBuffer | None) -> None:
        forward = load()
        assert forward is not None
        self._forward = forward
        self._core = core
        self._tape = tape
        arrays = k.new_arrays(len(core.links), descriptors, keep=tape is not None)
        self._arrays = {**arrays, "senders": core.senders}
        self.loop, self.ports = arrays["loop"], arrays["ports"]
        self._learned: dict[int, Layout] = {}
        self._plans: Plans | None = None
        self.loop[k.KEEP] = tape is not None
        self.loop[k.LINK_COUNT], self.loop[k.POLLS] = len(core.links), descriptors
        for number, role in enumerate(core.links):
            self.ports[number, k.FROM_VEHICLE] = role.direction == "from-vehicle"
        self._seen: tuple[Any, ...] = ()
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

    # What may be carried out

    def _learn(self, data: bytes) -> None:
        """Learn the first message of a datagram if it is new."""
        if len(data) < 8:
            return
        number = int.from_bytes(data[7:10], "little") if data[0] == 0xFD else data[5]
        if number in self._learned or number >= k.IDS:
            return
        described = find_layout(number)
        if described is not None:
            self._learned[number] = described
            self._describe(number, described)
            self._classify(number)

    def _describe(self, number: int, described: Layout) -> None:
        places = stamp_location(described.name) or (-1, 0, 0)
        values = (described.crc_extra, *places, *target_offsets(described.name))
        for column, value in zip(range(k.EXTRA, k.PLAN), values, strict=True):
            self._arrays["table"][number, column] = value

    def _refresh(self) -> None:
        """Follow the engine and the control path."""
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

    def _classify(self, number: int) -> None:
        """Set how a message is processed."""
        kind, first = self._way(number)
        self._arrays["table"][number, k.KIND], self._arrays["table"][number, k.PLAN] = kind, first

    def _way(self, number: int) -> tuple[int, int]:
        """The kind of a message, and the first row of its faults."""
        engine: Any = self._core.engine
        control = self._core.control
        # A signing key is routed and recorded with care.
        if number == SETUP_SIGNING or (control is not None and number in control.wanted):
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

            plans = Plans()
            self._tie(plans)
            self._plans = plans
        return self._plans

    # What was done

    def _settle(self) -> None:
        """Add the faults' counts to the engine, and the passed frames to the tape."""
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
        """Discard the machine code's record of the traffic; return the number of records."""
        loop = self.loop
        records = int(loop[k.INDEX_AT]) // INDEX.size
        loop[k.RECEIVED_AT] = loop[k.SENT_AT] = loop[k.INDEX_AT] = 0
        return records
