"""Active entries of value faults: several may change a frame before its CRC is recomputed."""

from typing import Any

from mavproxy_fault.fault_parts.draft import Change, Draft
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.fault_parts.value_fault import ValueState, can_add_sender
from mavproxy_fault.proxy.active_entry import ActiveEntry
from mavproxy_fault.schedule.entries import Entry
from mavproxy_fault.wire.frame import Frame, Number


class ActiveValueEntry(ActiveEntry):
    """Changes values in place; the values already include the changes of earlier entries."""

    def __init__(self, entry: Entry, *times: int, injected: bool = False) -> None:
        super().__init__(entry, *times, injected=injected)
        # Cached for use with every frame; a live edit of the value does not change them.
        self._elements, self._factors = self.fault.elements, self.fault.factors
        self._by_sender = self.fault.by_sender
        self._whole = all(one.code not in "fd" for row in self._elements.values() for one in row)

    def count_frames(self, frames: int, saturated: int, magnitude: float) -> None:
        """Add to the counts; a change of integers is written as an integer, not as a float."""
        super().count_frames(frames, saturated, (int if self._whole else float)(magnitude))

    def edit(self, draft: Draft, direction: str, t_us: int) -> None:
        """Apply the fault to a frame's values and count the change."""
        if self.skips_by_chance():
            return
        try:
            step, cut, differs = self._edit(draft, direction, t_us)
        except Exception as error:  # a failing plugin fault must not stop the forwarding
            self.note_failure(error)
            return
        if differs:
            self.note_changed_frame(direction, t_us)
            self.count_frames(1, cut, step)

    def _edit(self, draft: Draft, direction: str, t_us: int) -> Change:
        """Apply a fault to any number of elements, and with a state."""
        elements = self._elements[draft.id]
        start_us, inner = self.states.get(direction) or self.fresh_state(direction)
        before = draft.values(elements)
        key = draft.sender() if self._by_sender else ()
        if key and not can_add_sender(inner, key):
            return -1.0, 0, False
        t_s = (t_us - start_us) / 1e6
        if draft.id in self._factors:
            after, new = self._scaled(self._factors[draft.id], before, key, t_s, inner)
        else:
            after, new = self.fault.after(before, key, t_s, inner, self.rng)
        change = draft.write(elements, before, after)
        if new is not inner:  # most faults have no state
            self.states[direction] = ValueState(start_us, new)
        if self.ends_itself and self.fault.done(self.states[direction]):
            self.end_early(t_us)
        return change

    def _scaled(
        self, factors: tuple[float, ...], before: list[Number], key: Any, t_s: float, inner: Any
    ) -> tuple[list[Number], Any]:
        """Apply the fault to values in the units of the first target, and convert them back."""
        scaled = [x / f for x, f in zip(before, factors, strict=True)]
        after, new = self.fault.after(scaled, key, t_s, inner, self.rng)
        return [y * f for y, f in zip(after, factors, strict=True)], new

    def act(self, frame: Frame | bytes, direction: str, t_us: int) -> list[Outgoing]:
        """Apply the fault to a single frame, as when another fault has multiplied it."""
        assert isinstance(frame, Frame)
        draft = Draft(frame)
        self.edit(draft, direction, t_us)
        return [Outgoing(t_us, draft.sealed())]


def activate_entry(
    entry: Entry, seed: int, base_us: int, t0_us: int, *, injected: bool = False
) -> ActiveEntry:
    """Create the active entry of a schedule entry; parameters as for `ActiveEntry`."""
    # A fault with its own `apply` acts on entire frames, whatever its base class.
    kind = ActiveEntry if hasattr(entry.fault, "apply") else ActiveValueEntry
    return kind(entry, seed, base_us, t0_us, injected=injected)
