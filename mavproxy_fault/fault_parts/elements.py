"""The elements that value faults act on: their place in a message and their range of values.

Offset, end and `struct` code of each element are computed in advance, since the faults act on every
frame of fast streams. `draft.py` reads and writes them.
"""

import math
from typing import NamedTuple

from mavproxy_fault.wire.dialect import Layout
from mavproxy_fault.wire.frame import FLOAT_MAX, INTEGER_LIMITS, Number


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


def fit_to_type(code: str, value: Number) -> tuple[Number, bool]:
    """Return the nearest value that a type can hold, and whether it was saturated."""
    if code == "f":
        if -FLOAT_MAX <= value <= FLOAT_MAX or not math.isfinite(value):
            return value, False
        return math.copysign(FLOAT_MAX, value), True
    if code == "d":
        return value, False
    # NaN, which integers cannot represent and comparisons do not detect.
    if value != value:
        return 0, True
    low, high = INTEGER_LIMITS[code]
    # Up to half a count beyond the limit is rounding, not saturation.
    if value < low - 0.5:
        return low, True
    if value > high + 0.5:
        return high, True
    # `round` may exceed the limit by one count.
    return min(max(round(value), low), high), False
