"""The mutable copy of a frame for value faults: changed in place, sealed once at the end.

All value faults on a message share one copy of its bytes, one checksum and one new frame. Each
fault sees the changes of those before it. A comparison of bytes shows whether it changed anything.
`Frame.patched` does the same in general; it is used where an element lies in truncated zeros.
"""

import math
from collections.abc import Sequence
from functools import cache

from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.fault_parts.elements import Element, fit_to_type, locate_element
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.wire.dialect import PACKERS, message_layout
from mavproxy_fault.wire.frame import FLOAT_MAX, Frame, Number

INFINITE = math.inf
# Largest finite change (-1: none), number of saturated values, whether a byte differs.
Change = tuple[float, int, bool]


class Draft:
    """The mutable bytes of a frame; the checksum is that of the received frame until sealed."""

    __slots__ = ("_at", "_data", "_length", "came", "changed", "id", "layout")

    def __init__(self, frame: Frame) -> None:
        self.came = frame
        self.id, self.layout = frame.id, frame.layout
        self.changed = False
        self._set_data(bytearray(frame.raw), frame.payload_at, frame.length)

    def _set_data(self, data: bytearray, at: int, length: int) -> None:
        self._data, self._at, self._length = data, at, length

    def values(self, elements: Sequence[Element]) -> list[Number]:
        """Return the values of elements; truncated zeros read as 0."""
        at, data, length = self._at, self._data, self._length
        if len(elements) == 1 and elements[0].end <= length:  # without the loop
            return [*PACKERS[elements[0].code].unpack_from(data, at + elements[0].start)]
        found: list[Number] = []
        for _, _, start, end, code in elements:
            if end <= length:
                found += PACKERS[code].unpack_from(data, at + start)
            else:
                stored = bytes(data[at + start : at + length])
                found += PACKERS[code].unpack(stored.ljust(end - start, b"\0"))
        return found

    def write(
        self, elements: Sequence[Element], before: Sequence[Number], after: Sequence[Number]
    ) -> Change:
        """Write the values of elements."""
        if len(elements) != 1 or len(after) != 1:
            return self._write_several(elements, before, after)
        _, _, start, end, code = elements[0]
        value, cut = after[0], False
        # Fast path: a float within range, the most frequent case.
        if code != "f" or not -FLOAT_MAX <= value <= FLOAT_MAX:
            value, cut = fit_to_type(code, value)
        packer = PACKERS[code]
        packed = packer.pack(value)
        # The change as a receiver sees it, including rounding.
        step = abs(packer.unpack(packed)[0] - before[0])
        if end > self._length:
            differs = self._grow(elements[0], value)
        else:
            data, at = self._data, self._at
            # Zeros of different sign differ in their bytes only, as NaNs may.
            differs = step > 0.0 or data[at + start : at + end] != packed
            packer.pack_into(data, at + start, value)
        if differs:
            self.changed = True
        # NaN and infinity have no magnitude for a label.
        return step if step < INFINITE else -1.0, cut, differs

    def _write_several(
        self, elements: Sequence[Element], before: Sequence[Number], after: Sequence[Number]
    ) -> Change:
        saved = bytes(self._data), self._length, self.changed
        step, saturated, differs = -1.0, 0, False
        try:
            for one, healthy, value in zip(elements, before, after, strict=True):
                more, cut, changed = self.write((one,), (healthy,), (value,))
                step, saturated, differs = max(step, more), saturated + cut, differs or changed
        except Exception:
            # A fault that fails midway leaves the frame unchanged.
            self._set_data(bytearray(saved[0]), self._at, saved[1])
            self.changed = saved[2]
            raise
        return step, saturated, differs

    def _grow(self, one: Element, value: Number) -> bool:
        """Write a value into truncated zeros; return whether a byte differs."""
        frame = Frame(bytes(self._data), self.layout)
        patched = frame.patched({(one.name, one.item): value})
        self._set_data(bytearray(patched.raw), self._at, patched.length)
        return patched.payload != frame.payload

    def sealed(self) -> Frame:
        """Return the frame with its checksum; the received object itself if nothing changed."""
        if not self.changed:
            return self.came
        data, end = self._data, self._at + self._length
        # The checksum covers all after the start byte, and then the message's CRC_EXTRA.
        data[end] = self.layout.crc_extra
        crc = mcrf4xx(data[1 : end + 1])
        data[end] = crc & 0xFF
        data[end + 1] = crc >> 8
        return Frame(bytes(data), self.layout)

    def sender(self) -> tuple[int, ...]:
        """Return the sender: system, component, message id and instance."""
        came, instance, value = self.came, instance_element(self.id), 0
        # Instance 0 is often truncated.
        if instance and instance[0].start < self._length:
            number = self.values(instance)[0]
            value = number if isinstance(number, int) else 0
        return came.system, came.component, self.id, value


@cache
def instance_element(message: int) -> tuple[Element, ...]:
    """Return the element that distinguishes sensors with the same message, if there is one."""
    layout = message_layout(message)
    name = layout.instance or ("id" if "id" in layout.fields else "")
    return (locate_element(layout, name),) if name else ()


def rewrite_fields(frame: Frame, t_us: int, values: dict[str, Number]) -> Outgoing:
    """Replace the values of fields that are not arrays."""
    draft = Draft(frame)
    elements = [locate_element(frame.layout, name) for name in values]
    step, cut, differs = draft.write(elements, draft.values(elements), list(values.values()))
    if not differs:
        return Outgoing(t_us, frame)
    return Outgoing(t_us, draft.sealed(), step if step >= 0.0 else None, cut)
