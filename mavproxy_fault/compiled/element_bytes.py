"""Elements of a frame as numbers, and back, by address; as `fault_parts.elements` does."""

from typing import Any

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.kernel import i64, kernel, kernel_of
from mavproxy_fault.fault_parts import elements
from mavproxy_fault.wire import frame
from mavproxy_fault.wire.framing import load8, load32, load64, store8, store32, store64

LARGEST_WHOLE = 1 << 53  # larger 64-bit integers are no exact numbers

fit_float = kernel_of(elements.fit_float)
fit_integer = kernel_of(elements.fit_integer)
larger_change = kernel_of(elements.larger_change)
sent_length = kernel_of(frame.sent_length)


@kernel
def little_endian(place: int, size: int) -> Any:
    """A little-endian number of `size` bytes; 0 for none."""
    if size == 4:
        return i64(load32(np.uint64(place)))
    if size == 8:
        return i64(load64(np.uint64(place)))
    value = i64(0)
    for n in range(size):
        value |= i64(load8(np.uint64(place + n))) << (8 * n)
    return value


@kernel
def copy_bytes(source: k.Octets, at: int, length: int, target: k.Octets, to: int) -> None:
    """Copy bytes by eights; up to seven more may change behind them."""
    begin, end = source.ctypes.data + at, target.ctypes.data + to
    for n in range(0, length, 8):
        store64(np.uint64(end + n), load64(np.uint64(begin + n)))


@kernel
def read_element(place: int, size: int, kind: int) -> float:
    """The value of an element."""
    word = little_endian(place, size)
    if kind == k.REAL and size == 4:
        return float(np.uint32(word).view(np.float32))
    if kind == k.REAL:
        return float(np.uint64(word).view(np.float64))
    if kind == k.SIGNED and size < 8 and word >> (8 * size - 1):
        word -= i64(1) << (8 * size)
    return float(word)


@kernel
def write_element(place: int, size: int, kind: int, new: float) -> bool:
    """Write the nearest value that the element can hold; whether that is saturated."""
    signed, cut = 1 if kind == k.SIGNED else 0, False
    if kind != k.REAL:
        high = (i64(1) << min(8 * size - signed, 63)) - 1
        word, cut = fit_integer(new, -signed * (high + 1), high)
    elif size == 4:
        single, cut = fit_float(new)
        word = i64(np.float32(single).view(np.uint32))
    else:
        word = i64(np.float64(new).view(np.uint64))
    if size == 4:
        store32(np.uint64(place), np.uint32(word & 0xFFFFFFFF))
    else:
        for n in range(size):
            store8(np.uint64(place + n), np.uint8(word >> (8 * n) & 0xFF))
    return bool(cut)
