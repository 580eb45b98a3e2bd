"""The elements that value faults act on: where they lie in a message, and what fits them.

The faults act on every frame of a fast stream, so what can be known beforehand is: offset, end and
`struct` code of each element. `draft.py` reads and writes them.
"""

import math
from typing import NamedTuple

from mavproxy_fault.wire.dialect import Layout
from mavproxy_fault.wire.frame import FLOAT_MAX, INTEGER_LIMITS, Number


class Element(NamedTuple):
    """One element of a field: `item` in an array, else 0; its bytes within the payload."""

    name: str
    item: int
    start: int
    end: int
    code: str


def locate_element(layout: Layout, name: str, index: int = 0) -> Element:
    """An element of a message by its field and index."""
    field = layout.fields[name]
    start = field.offset + index * field.size
    return Element(name, index, start, start + field.size, field.code)


def fit_to_type(code: str, value: Number) -> tuple[Number, bool]:
    """The nearest value that a type can hold, and whether more than rounding was lost."""
    if code == "f":
        if -FLOAT_MAX <= value <= FLOAT_MAX or not math.isfinite(value):
            return value, False
        return math.copysign(FLOAT_MAX, value), True
    if code == "d":
        return value, False
    # NaN, which no integer holds; the comparisons below would pass it.
    if value != value:
        return 0, True
    low, high = INTEGER_LIMITS[code]
    # Half a count beyond the limit still rounds to it: nothing is lost.
    if value < low - 0.5:
        return low, True
    if value > high + 0.5:
        return high, True
    # `round` at the very edge may reach one count beyond.
    return min(max(round(value), low), high), False
