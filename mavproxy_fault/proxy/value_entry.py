"""Active entries of value faults: several may change a frame before its CRC is recomputed."""

import math
import sys
from collections.abc import Sequence
from typing import Any

from mavproxy_fault.fault_parts.draft import INFINITE, Change, Draft
from mavproxy_fault.fault_parts.elements import Element
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.fault_parts.value_fault import ValueState, can_add_sender
from mavproxy_fault.proxy.active_entry import ActiveEntry
from mavproxy_fault.schedule.entries import Entry
from mavproxy_fault.wire.frame import FLOAT_MAX, Frame, Number

FLOAT_MIN = -FLOAT_MAX
NO_FLOAT_INDEX = 1 << 16  # beyond any payload


def float_index(elements: Sequence[Element]) -> int:
    """Return the index of a single float in the payload; NO_FLOAT_INDEX for others."""
    one = elements[0]
    alone = len(elements) == 1 and one.code == "f" and one.start % 4 == 0
    return one.start // 4 if alone and sys.byteorder == "little" else NO_FLOAT_INDEX


class ActiveValueEntry(ActiveEntry):
    """Changes values in place; the values already include the changes of earlier entries."""

    def __init__(self, entry: Entry, *times: int, injected: bool = False) -> None:
        super().__init__(entry, *times, injected=injected)
        # Cached for use with every frame; a live edit of the value does not change them.
        self._elements, self._factors = self.fault.elements, self.fault.factors
        self._by_sender = self.fault.by_sender
        self._chance = entry.probability
        quick = self.fault.by_value and not self.ends_itself
        self._floats = {
            number: float_index(elements)
            if quick and number not in self._factors
            else NO_FLOAT_INDEX
            for number, elements in self._elements.items()
        }
        self._of = self.fault.of

    def edit(self, draft: Draft, direction: str, t_us: int) -> None:
        """Apply the fault to a frame's values and count the change."""
        if self._chance < 1.0 and self.skips_by_chance():
            return
        place, floats = self._floats[draft.id], draft.floats
        try:
            if place < len(floats):  # fast path: a single float
                healthy = floats[place]
                value = self._of(healthy, (t_us - self.start_us) / 1e6)
                if type(value) is float and value != healthy and FLOAT_MIN <= value <= FLOAT_MAX:
                    floats[place] = value
                    # Read back to get the change after rounding, as a receiver sees it.
                    step, cut = abs(floats[place] - healthy), 0
                    # 0.0 and -0.0 differ only in their bytes.
                    differs = step != 0.0 or math.copysign(1.0, value) != math.copysign(
                        1.0, healthy
                    )
                else:
                    elements = self._elements[draft.id]
                    step, cut, differs = draft.write(elements, [healthy], [value])
            else:
                step, cut, differs = self._edit(draft, direction, t_us)
        except Exception as error:  # a failing plugin fault must not stop the forwarding
            self.note_failure(error)
            return
        if differs:
            draft.changed = True
            if direction != self.direction:
                self.note_changed_frame(direction, t_us)
            # Inlined `credit`, as this runs once per frame.
            self.frames += 1
            self.saturated += cut
            if self._largest < step < INFINITE:
                self._largest = step

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

    def _change(self, inner: Any, value: float) -> None:
        """Set another constant value."""
        super()._change(inner, value)
        self._of = self.fault.of

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
