"""An entry of a value fault at work: several of them change a frame before it is sealed."""

from typing import Any

from mavproxy_fault.fault_parts.draft import Draft
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.fault_parts.value_fault import ValueState
from mavproxy_fault.proxy.active_entry import Running
from mavproxy_fault.schedule.entries import Entry
from mavproxy_fault.wire.frame import Frame, Number


class RunningValueFault(Running):
    """It changes values in place; what the others on the frame have done is in them already."""

    def __init__(self, entry: Entry, *times: int, injected: bool = False) -> None:
        super().__init__(entry, *times, injected=injected)
        # They stay when a live request changes the value; asked for with every frame.
        self._elements, self._factors = self.fault.elements, self.fault.factors
        self._by_sender = self.fault.by_sender
        self._chance = entry.probability

    def edit(self, draft: Draft, direction: str, t_us: int) -> None:
        """Put a frame's values through the rule and count what it did."""
        if self._chance < 1.0 and self.spares():
            return
        elements = self._elements[draft.id]
        try:
            state = self.states.get(direction) or self.fresh_state(direction)
            start_us, inner = state
            before = draft.values(elements)
            key = draft.sender() if self._by_sender else ()
            t_s = (t_us - start_us) / 1e6
            if draft.id in self._factors:
                after, new = self._scaled(self._factors[draft.id], before, key, t_s, inner)
            else:
                after, new = self.fault.after(before, key, t_s, inner, self.rng)
            step, cut, differs = draft.write(elements, before, after)
        except Exception as error:  # others write faults too: theirs must not end the forwarding
            self.note_failure(error)
            return
        if new is not inner:  # most faults keep nothing
            self.states[direction] = ValueState(start_us, new)
        if self.ends_itself and self.fault.done(self.states[direction]):
            self.end_us = t_us
        if differs:
            if direction != self.direction:
                self.note_touch(direction, t_us)
            self.credit(1, cut, t_us, step)

    def _scaled(
        self, factors: tuple[float, ...], before: list[Number], key: Any, t_s: float, inner: Any
    ) -> tuple[list[Number], Any]:
        """The same for a message in other units: the fault thinks in that of the first target."""
        seen = [x / f for x, f in zip(before, factors, strict=True)]
        after, new = self.fault.after(seen, key, t_s, inner, self.rng)
        return [y * f for y, f in zip(after, factors, strict=True)], new

    def act(self, frame: Frame | bytes, direction: str, t_us: int) -> list[Outgoing]:
        """The same on one frame alone, as where another fault has made several of one."""
        assert isinstance(frame, Frame)
        draft = Draft(frame)
        self.edit(draft, direction, t_us)
        return [Outgoing(t_us, draft.sealed())]


def at_work(
    entry: Entry, seed: int, base_us: int, t0_us: int, *, injected: bool = False
) -> Running:
    """The entry with all that it needs to act; what the parameters mean, see `Running`."""
    # One with an `apply` of its own acts on whole frames, whatever it derives from.
    kind = Running if hasattr(entry.fault, "apply") else RunningValueFault
    return kind(entry, seed, base_us, t0_us, injected=injected)
