"""Frame boundaries and checksums in compiled code, shared by the log reader and the proxy.

Memory is read eight bytes at a time by address; the bounds of each access are stated beside it.
Importing this module imports numba.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic

Function = TypeVar("Function", bound=Callable[..., Any])


def inline_in_kernels(function: Function) -> Function:
    """Decorate a function that compiled code calls; LLVM inlines it into its caller.

    numba's own inlining (`inline="always"`) types the body anew for each call: `log_walk.walk` then
    took 18.6 s of processor time to compile (benchmarks/compile_costs.md).
    """
    return cast(
        Function, njit(forceinline=True, no_cfunc_wrapper=True, no_cpython_wrapper=True)(function)
    )


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
load32, store32 = _access(32)
load64, store64 = _access(64)


@intrinsic  # type: ignore[untyped-decorator]
def _swap_bytes(_: Any, value: Any) -> Any:
    """Reverse the byte order of a 64-bit word."""

    def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        return builder.bswap(values[0])

    return types.uint64(types.uint64), code


@inline_in_kernels
def big_endian64(address: Any) -> Any:
    """Read a big-endian 64-bit integer, the format of timestamps in a tlog."""
    return np.int64(_swap_bytes(load64(np.uint64(address))))


@inline_in_kernels
def byte_at(address: Any) -> Any:
    """Read one byte as an unsigned 64-bit integer."""
    return np.uint64(load8(np.uint64(address)))


@inline_in_kernels
def _crc_step(word: Any, tables: Any) -> Any:
    """Advance the CRC by eight bytes; `word` is their value XOR the previous CRC."""
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
    """Compute the CRC of the bytes at addresses [start, stop) followed by the CRC extra.

    Needs two or more bytes. XORing the initial value 0xFFFF into the first two makes leading zeros
    neutral, so the odd bytes are processed first, zero-padded to a word. Reads eight bytes from
    `start`, which the shortest frame contains. `tables` of `numerics.crc` have shape (8, 256).
    """
    odd = (stop - start) & 7
    crc = np.uint64(0xFFFF)
    if odd:
        word = (load64(np.uint64(start)) ^ crc) << np.uint64(64 - 8 * odd)
        crc = _crc_step(word, tables) ^ np.uint64(0xFF * (odd == 1))
    at = start + odd
    while at < stop:
        crc = _crc_step(load64(np.uint64(at)) ^ crc, tables)
        at += 8
    return (crc >> np.uint64(8)) ^ np.uint64(tables[0, (crc ^ extra) & np.uint64(0xFF)])


@inline_in_kernels
def has_valid_checksum(base: Any, at: Any, head: Any, extra: Any, tables: Any) -> Any:
    """Whether the checksum of the frame at `at` is correct; `head` is its header length."""
    tail = base + at + head + np.int64(byte_at(base + at + 1))
    sent = byte_at(tail) | byte_at(tail + 1) << np.uint64(8)
    return range_crc(base + at + 1, tail, extra, tables) == sent
