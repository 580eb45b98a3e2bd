"""Where a frame is and whether its checksum is right, in compiled code.

The log reader and the compiled form of the proxy share these. They read memory eight bytes at a
time by address: what bounds each access is said beside it. Importing this file imports numba.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic, register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])


def inline_in_kernels(function: Function) -> Function:
    """Let compiled code call a function, which becomes part of its caller."""
    return cast(Function, register_jitable(inline="always")(function))


def _access(bits: int) -> tuple[Any, Any]:
    """Intrinsics that load and store an unaligned little-endian word at an address."""
    word = getattr(types, f"uint{bits}")

    def load(_: Any, address: Any) -> Any:
        def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
            pointer = builder.inttoptr(values[0], ir.IntType(bits).as_pointer())
            loaded = builder.load(pointer)
            loaded.align = 1  # frames begin at any byte
            return loaded

        return word(types.uint64), code

    def store(_: Any, address: Any, value: Any) -> Any:
        def code(__: Any, builder: Any, ___: Any, values: Any) -> None:
            pointer = builder.inttoptr(values[0], ir.IntType(bits).as_pointer())
            stored = builder.store(values[1], pointer)
            stored.align = 1

        return types.void(types.uint64, word), code

    return intrinsic(load), intrinsic(store)


load8, store8 = _access(8)
load64, store64 = _access(64)


@intrinsic  # type: ignore[untyped-decorator]
def _swap_bytes(_: Any, value: Any) -> Any:
    """The eight bytes of a word in opposite order."""

    def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        return builder.bswap(values[0])

    return types.uint64(types.uint64), code


@inline_in_kernels
def big_endian64(address: Any) -> Any:
    """A big-endian word of eight bytes, as tlogs stamp their records."""
    return np.int64(_swap_bytes(load64(np.uint64(address))))


@inline_in_kernels
def byte_at(address: Any) -> Any:
    """One byte, as an unsigned word."""
    return np.uint64(load8(np.uint64(address)))


@inline_in_kernels
def _crc_step(word: Any, tables: Any) -> Any:
    """CRC of eight bytes that a CRC was put into."""
    low = np.uint64(0xFF)
    return np.uint64(
        tables[7, word & low]
        ^ tables[6, word >> np.uint64(8) & low]
        ^ tables[5, word >> np.uint64(16) & low]
        ^ tables[4, word >> np.uint64(24) & low]
        ^ tables[3, word >> np.uint64(32) & low]
        ^ tables[2, word >> np.uint64(40) & low]
        ^ tables[1, word >> np.uint64(48) & low]
        ^ tables[0, word >> np.uint64(56)]
    )


@inline_in_kernels
def range_crc(start: Any, stop: Any, extra: Any, tables: Any) -> Any:
    """CRC of the two or more bytes at addresses [start, stop) and of the CRC extra.

    The start value 0xFFFF is put into the first two bytes; then zeros before them change nothing,
    and the odd bytes go first, as the end of a word of zeros. Eight bytes from `start` on are read,
    which lie within the shortest frame. `tables` are those of `numerics.crc`, shape (8, 256).
    """
    odd = (stop - start) & 7
    found = np.uint64(0xFFFF)
    if odd:
        word = (load64(np.uint64(start)) ^ found) << np.uint64(64 - 8 * odd)
        found = _crc_step(word, tables) ^ np.uint64(0xFF * (odd == 1))
    at = start + odd
    while at < stop:
        found = _crc_step(load64(np.uint64(at)) ^ found, tables)
        at += 8
    return (found >> np.uint64(8)) ^ np.uint64(tables[0, (found ^ extra) & np.uint64(0xFF)])


@inline_in_kernels
def frame_header(base: Any, size: Any, at: Any) -> Any:
    """Bytes before the payload, message id and end of the frame at `at`; zeros if none is whole.

    `base` is the address of the data, `size` and `at` count bytes from there. No message is without
    payload: nine bytes of a frame can be read (of version 2: twelve).
    """
    if at + 12 > size and (at + 9 > size or byte_at(base + at) != 0xFE):
        return 0, 0, 0
    first = byte_at(base + at)
    if first == 0xFE:
        head, number, tail = 6, np.int64(byte_at(base + at + 5)), np.int64(2)
    elif first == 0xFD and byte_at(base + at + 2) <= 1:
        word = load64(np.uint64(base + at + 4)) >> np.uint64(24)  # within the 12 bytes
        head, number = 10, np.int64(word & np.uint64(0xFFFFFF))
        tail = 2 + 13 * np.int64(byte_at(base + at + 2))  # a signature is 13 bytes
    else:
        return 0, 0, 0
    end = at + head + np.int64(byte_at(base + at + 1)) + tail
    if end > size:
        return 0, 0, 0
    return head, number, end


@inline_in_kernels
def has_valid_checksum(base: Any, at: Any, head: Any, extra: Any, tables: Any) -> Any:
    """Whether the checksum of a frame whose `frame_header` was found is right."""
    tail = base + at + head + np.int64(byte_at(base + at + 1))
    sent = byte_at(tail) | byte_at(tail + 1) << np.uint64(8)
    return range_crc(base + at + 1, tail, extra, tables) == sent
