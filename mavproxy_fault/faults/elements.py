"""Where a value fault's elements lie in the bytes of a frame; read and written there.

The faults act on every frame of a fast stream, so all that can be known beforehand is: offset,
`struct` and limits of each element. `Frame.patched` says the same in general and serves where an
element reaches into zeros that were cut.
"""

import math
import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.faults.fault import Outgoing
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import FLOAT_MAX, INTEGER_LIMITS, Frame, Number

Element = tuple[str, int]  # field and index
CRC_EXTRA = [bytes((n,)) for n in range(256)]


class Place(NamedTuple):
    """One element: its name and index, its bytes within the payload, and how they are packed."""

    name: str
    item: int
    start: int
    end: int
    packer: struct.Struct
    code: str


@lru_cache(maxsize=512)
def places_of(message: int, elements: tuple[Element, ...]) -> tuple[Place, ...]:
    """The places of some elements of a message."""
    found = []
    for name, index in elements:
        field = known(message).fields[name]
        start = field.offset + index * field.size
        packer = struct.Struct("<" + field.code)
        found.append(Place(name, index, start, start + field.size, packer, field.code))
    return tuple(found)


def values_at(frame: Frame, places: Sequence[Place]) -> list[Number]:
    """The values of a frame at some places; zeros that were cut read as 0."""
    at, raw, length = frame.payload_at, frame.raw, frame.length
    return [
        place.packer.unpack_from(raw, at + place.start)[0]
        if place.end <= length
        else frame.number(place.name, place.item)
        for place in places
    ]


def changed(
    frame: Frame,
    t_us: int,
    places: Sequence[Place],
    before: Sequence[Number],
    after: Sequence[Number],
) -> Outgoing:
    """The frame with other values at some places; the same object if no byte differs."""
    at, length = frame.payload_at, frame.length
    raw = bytearray(frame.raw)
    # Below every change: the first finite one counts, also a change of zero.
    size = -1.0
    saturated = 0
    for (_, _, start, stop, packer, code), healthy, value in zip(
        places, before, after, strict=True
    ):
        if stop > length:
            return _beyond(frame, t_us, places, before, after)
        # A float within range needs no fitting; that is nearly every value of a fast stream.
        if code != "f" or not -FLOAT_MAX <= value <= FLOAT_MAX:
            value, cut = fitted(code, value)
            saturated += cut
        packer.pack_into(raw, at + start, value)
        # Read back: the change that a receiver sees, rounding included.
        step = abs(packer.unpack_from(raw, at + start)[0] - healthy)
        if size < step < math.inf:
            size = step
    # Nothing differs after rounding: the same object goes on, and counts as untouched.
    if raw == frame.raw:
        return Outgoing(t_us, frame)
    end = at + length
    # The checksum covers all behind the start byte, and then the message's own CRC_EXTRA.
    crc = mcrf4xx(CRC_EXTRA[frame.layout.crc_extra], mcrf4xx(raw[1:end]))
    raw[end] = crc & 0xFF
    raw[end + 1] = crc >> 8
    return Outgoing(t_us, Frame(bytes(raw), frame.layout), size if size >= 0 else None, saturated)


def _beyond(
    frame: Frame,
    t_us: int,
    places: Sequence[Place],
    before: Sequence[Number],
    after: Sequence[Number],
) -> Outgoing:
    """The same where an element lies in the zeros that were cut."""
    patched = frame.patched(
        {(place.name, place.item): value for place, value in zip(places, after, strict=True)}
    )
    if patched.raw == frame.raw:
        return Outgoing(t_us, frame)
    saturated = sum(fitted(p.code, value)[1] for p, value in zip(places, after, strict=True))
    return Outgoing(t_us, patched, largest(before, values_at(patched, places)), saturated)


def fitted(code: str, value: Number) -> tuple[Number, bool]:
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


def largest(before: Sequence[Number], after: Sequence[Number]) -> float | None:
    """The largest finite change."""
    steps = [abs(b - a) for a, b in zip(before, after, strict=True)]
    # NaN and infinity have no size that a label could hold.
    return max((step for step in steps if math.isfinite(step)), default=None)


def rewritten(frame: Frame, t_us: int, values: dict[str, Number]) -> Outgoing:
    """The frame with other values in some fields that are no arrays."""
    places = places_of(frame.id, tuple((name, 0) for name in values))
    return changed(frame, t_us, places, values_at(frame, places), list(values.values()))
