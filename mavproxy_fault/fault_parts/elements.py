"""The elements that value faults act on: their place in a message, and reading and writing them.

`compiled.element_bytes` does the same by address. A comparison of bytes shows whether a value has
changed: zeros of different sign differ in their bytes only, as NaNs may.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.wire.dialect import PACKERS, Layout, message_layout
from mavproxy_fault.wire.frame import FLOAT_MAX, INTEGER_LIMITS, Frame, Number, sent_length


class Element(NamedTuple):
    """One element of a field (`item` is 0 except in arrays) and its bytes in the payload."""

    name: str
    item: int
    start: int
    end: int
    code: str


def locate_element(layout: Layout, name: str, index: int = 0) -> Element:
    """Return the element of a message for a field and index."""
    field = layout.fields[name]
    start = field.offset + index * field.size
    return Element(name, index, start, start + field.size, field.code)


def fit_float(value: float) -> tuple[float, bool]:
    """Return the nearest value of a float32, and whether it was saturated; a rule (`rules`)."""
    if not math.isfinite(value) or abs(value) <= FLOAT_MAX:
        return value, False
    return math.copysign(FLOAT_MAX, value), True


def fit_integer(value: Number, low: int, high: int) -> tuple[int, bool]:
    """Return the nearest integer from `low` to `high`, and whether it was saturated; a rule.

    Up to half a count beyond the limit is rounding, not saturation.
    """
    if value != value:  # NaN, which integers cannot represent and comparisons do not detect
        return 0, True
    if value <= low:
        return low, value < low - 0.5
    if value >= high:
        return high, value > high + 0.5
    return round(value), False


def larger_change(largest: float, before: Number, after: Number, scale: float) -> float:
    """Return the larger of a label's magnitude, -1 for none, and a change; a rule.

    NaN and infinity have no magnitude.
    """
    change = abs(after - before) / scale
    return max(largest, change) if change < math.inf else largest


def fit_to_type(code: str, value: Number) -> tuple[Number, bool]:
    """Return the nearest value that a type can hold, and whether it was saturated."""
    if code == "f":
        return fit_float(value)
    return (value, False) if code == "d" else fit_integer(value, *INTEGER_LIMITS[code])


def read_elements(frame: Frame, elements: Sequence[Element]) -> list[Number]:
    """Return the values of elements; truncated zeros read as 0."""
    payload = frame.payload.ljust(frame.layout.length, b"\0")
    return [PACKERS[one.code].unpack_from(payload, one.start)[0] for one in elements]


def write_elements(
    frame: Frame,
    t_us: int,
    elements: Sequence[Element],
    after: Sequence[Number],
    scales: Sequence[float] | None = None,
) -> Outgoing:
    """Return the frame with other values, due at `t_us`; the same object if no byte differs.

    Its magnitude is the largest finite change as a receiver sees it, with rounding, divided by the
    scale of its element. The payload grows only as far as a change reaches into truncated zeros.
    """
    payload = bytearray(frame.payload.ljust(frame.layout.length, b"\0"))
    largest, saturated = -1.0, 0
    for one, value, scale in zip(elements, after, scales or (1,) * len(elements), strict=True):
        packer = PACKERS[one.code]
        (healthy,) = packer.unpack_from(payload, one.start)
        stored, cut = fit_to_type(one.code, value)
        packer.pack_into(payload, one.start, stored)
        changed = packer.unpack_from(payload, one.start)[0]
        largest = larger_change(largest, healthy, changed, scale)
        saturated += cut
    sent = bytes(payload[: sent_length(payload, 0, frame.length, len(payload))])
    if sent == frame.payload:
        return Outgoing(t_us, frame)
    size = largest if largest >= 0.0 else None
    return Outgoing(t_us, frame.with_payload(sent), size, saturated)


def patch_frame(frame: Frame, values: Mapping[Element, Number]) -> Frame:
    """Return the frame with other values of some elements, as `write_elements` writes them."""
    patched = write_elements(frame, 0, [*values], [*values.values()]).frame
    assert isinstance(patched, Frame)
    return patched


@cache
def instance_element(message: int) -> tuple[Element, ...]:
    """Return the element that distinguishes sensors with the same message, if there is one."""
    layout = message_layout(message)
    return (locate_element(layout, layout.instance),) if layout.instance else ()


def sender_of(frame: Frame) -> tuple[int, ...]:
    """Return the sender: system, component, message id and instance."""
    found = read_elements(frame, instance_element(frame.id))
    instance = found[0] if found and isinstance(found[0], int) else 0
    return frame.system, frame.component, frame.id, instance
