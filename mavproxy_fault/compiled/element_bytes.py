"""Elements of a frame as numbers, and back, by address; as `fault_parts.elements` does."""

from typing import Any

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.kernel import i64, kernel
from mavproxy_fault.wire.frame import FLOAT_MAX

DOUBLE, SINGLE = ord("d"), ord("f")
LARGEST_WHOLE = 1 << 53  # larger 64-bit integers are no exact numbers


@kernel
def little_endian(data: k.Octets, at: int, size: int) -> Any:
    """A little-endian number of `size` bytes; 0 for none."""
    value = i64(0)
    for n in range(size):
        value |= i64(data[at + n]) << (8 * n)
    return value


@kernel
def element_size(code: int) -> int:
    """Bytes of one element, by its `struct` code."""
    if code == 98 or code == 66:  # b, B
        return 1
    if code == 104 or code == 72:  # h, H
        return 2
    return 8 if code == DOUBLE or code == 113 or code == 81 else 4  # d, q, Q; f, i, I


@kernel
def read_element(data: k.Octets, at: int, code: int) -> float:
    """The value of an element."""
    bits = 8 * element_size(code)
    word = little_endian(data, at, bits // 8)
    if code == SINGLE:
        return float(np.uint32(word).view(np.float32))
    if code == DOUBLE:
        return float(np.uint64(word).view(np.float64))
    if code > 96 and bits < 64 and word >> (bits - 1):  # lower case: signed
        word -= i64(1) << bits
    return float(word)


@kernel
def _integer_word(new: float, code: int, healthy: float, outcome: k.Doubles) -> int:
    """The nearest integer of a type."""
    bits = 8 * element_size(code)
    signed = code > 96
    low = -(i64(1) << (bits - 1)) if signed else i64(0)
    high = (i64(1) << (bits - 1 if signed else min(bits, 63))) - 1
    stored = i64(0)
    if np.isnan(new):
        outcome[k.CUT] = 1.0
    else:
        outcome[k.CUT] = 0.0 if low - 0.5 <= new <= high + 0.5 else 1.0
        stored = low if new <= low else high if new >= high else i64(np.rint(new))
    outcome[k.STEP] = abs(np.float64(stored) - healthy)
    return stored


@kernel
def write_element(
    data: k.Octets, at: int, code: int, healthy: float, new: float, outcome: k.Doubles
) -> bool:
    """Write a value; whether a byte changed. Step and saturation go to `outcome`."""
    outcome[k.CUT] = 0.0
    word = i64(0)
    if code == SINGLE:
        if np.isfinite(new) and abs(new) > FLOAT_MAX:
            outcome[k.CUT] = 1.0
            new = FLOAT_MAX if new > 0 else -FLOAT_MAX
        single = np.float32(new)
        outcome[k.STEP] = abs(np.float64(single) - healthy)
        word = i64(single.view(np.uint32))
    elif code == DOUBLE:
        outcome[k.STEP] = abs(new - healthy)
        word = i64(np.float64(new).view(np.uint64))
    else:
        word = _integer_word(new, code, healthy, outcome)
    changed = False
    for n in range(element_size(code)):
        byte = word >> (8 * n) & 0xFF
        changed |= data[at + n] != byte
        data[at + n] = byte
    return changed
