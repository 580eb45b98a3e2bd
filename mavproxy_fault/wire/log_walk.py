"""The compiled walk over a log's bytes: where the frames are, and their payloads into columns.

Importing this file imports numba (half a second); the compiled code is cached on disk. The kernels
release the interpreter's lock. They read and write memory eight bytes at a time by address: what
bounds each access is said beside it. The CRC (CRC-16/MCRF4XX, reflected polynomial 0x8408) goes
eight bytes a step by eight tables ("slicing-by-8" [1]_).

References
----------
.. [1] Kounavis and Berry, "A Systematic Approach to Building High Performance Software-based CRC
       Generators", ISCC 2005.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

HEAD = 11  # bytes of a row before the payload: t_us, system, component, seq
SLACK = 16  # bytes that must follow the rows of each message: stores are eight bytes wide
UNKNOWN = -1  # the slot of a frame whose message the dialect does not know
NEAR_US = 1 << 36  # two neighbouring stamps further apart than this (19 h) do not belong together
SLIP_US = 60_000_000  # a stamp this far from its neighbours may be damaged


def crc_tables() -> NDArray[np.uint16]:
    """Slicing tables, shape (8, 256): entry [k, b] is the CRC of byte b followed by k zeros."""
    tables = np.zeros((8, 256), np.uint16)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
        tables[0, byte] = crc
    for k in range(1, 8):
        tables[k] = (tables[k - 1] >> 8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


def _memory(bits: int) -> Any:
    """Intrinsics that load and store an unaligned little-endian word at an address."""
    word = getattr(types, f"uint{bits}")

    @intrinsic
    def load(_, address):
        def code(__, builder, ___, values):
            pointer = builder.inttoptr(values[0], ir.IntType(bits).as_pointer())
            loaded = builder.load(pointer)
            loaded.align = 1
            return loaded

        return word(types.uint64), code

    @intrinsic
    def store(_, address, value):
        def code(__, builder, ___, values):
            pointer = builder.inttoptr(values[0], ir.IntType(bits).as_pointer())
            stored = builder.store(values[1], pointer)
            stored.align = 1

        return types.void(types.uint64, word), code

    return load, store


_load8, _store8 = _memory(8)
_load64, _store64 = _memory(64)


@intrinsic
def _swapped(_, value):
    """The eight bytes of a word in opposite order."""

    def code(__, builder, ___, values):
        return builder.bswap(values[0])

    return types.uint64(types.uint64), code


@njit(cache=True, nogil=True, inline="always")
def _byte(address):
    return np.uint64(_load8(np.uint64(address)))


@njit(cache=True, nogil=True, inline="always")
def _stamp(address):
    return np.int64(_swapped(_load64(np.uint64(address))))


@njit(cache=True, nogil=True, inline="always")
def _crc_step(word, tables):
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


@njit(cache=True, nogil=True, inline="always")
def _crc(start, stop, extra, tables):
    """CRC of the two or more bytes at addresses [start, stop) and of `extra`.

    The start value 0xFFFF is put into the first two bytes; then zeros before them change nothing,
    and the odd bytes go first, as the end of a word of zeros. Eight bytes from `start` on are read.
    """
    odd = (stop - start) & 7
    crc = np.uint64(0xFFFF)
    if odd:
        word = (_load64(np.uint64(start)) ^ crc) << np.uint64(64 - 8 * odd)
        crc = _crc_step(word, tables) ^ np.uint64(0xFF * (odd == 1))
    at = start + odd
    while at < stop:
        crc = _crc_step(_load64(np.uint64(at)) ^ crc, tables)
        at += 8
    return (crc >> np.uint64(8)) ^ np.uint64(tables[0, (crc ^ extra) & np.uint64(0xFF)])


@njit(cache=True, nogil=True, inline="always")
def _header(base, size, at):
    """Bytes before the payload, message id and end of a frame at `at`; zeros if none is whole.

    No message is without payload: nine bytes of a frame can be read (of version 2: twelve).
    """
    if at + 12 > size and (at + 9 > size or _byte(base + at) != 0xFE):
        return 0, 0, 0
    first = _byte(base + at)
    if first == 0xFE:
        head, number, tail = 6, np.int64(_byte(base + at + 5)), 2
    elif first == 0xFD and _byte(base + at + 2) <= 1:
        word = _load64(np.uint64(base + at + 4)) >> np.uint64(24)  # within the 12 bytes
        head, number = 10, np.int64(word & np.uint64(0xFFFFFF))
        tail = 2 + 13 * np.int64(_byte(base + at + 2))
    else:
        return 0, 0, 0
    end = at + head + np.int64(_byte(base + at + 1)) + tail
    if end > size:
        return 0, 0, 0
    return head, number, end


@njit(cache=True, nogil=True, inline="always")
def _follows(base, size, at, end):
    """Whether a further record, stamped near the one whose frame is at `at`, starts at `end`."""
    if end + 9 > size:
        return True
    first = _byte(base + end + 8)
    if first != 0xFE and first != 0xFD:
        return False
    return abs(_stamp(base + end) - _stamp(base + at - 8)) < NEAR_US


@njit(cache=True, nogil=True)
def walk(data, start, slots, extras, tables, runs, counts):
    """Find frames from byte `start` on until `runs` could overflow or the data ends.

    Where a record does not verify, every later byte is tried as the start of a frame, so that one
    broken record costs no intact one. A message that the dialect does not know has no checksum to
    verify: it counts as a frame only between a record that ended there and one that follows.

    Parameters
    ----------
    data : uint8 array (n,)
        The log.
    start : int
        Where the previous record ended.
    slots : int16 array
        Slot of each message id, -1 where it is unknown; ids beyond are unknown too.
    extras : uint64 array
        CRC extra of each slot.
    tables : uint16 array (8, 256)
        From `crc_tables`.
    runs : int64 array (m, 2)
        Filled: where a frame starts that is followed by others record upon record, and how many
        they are with it. At most m frames are looked for.
    counts : int64 array
        Frames of each slot, counted up.

    Returns
    -------
    tuple
        Runs found, where to go on (the data's length at its end), bytes belonging to no record.
    """
    size = data.shape[0]
    base = data.ctypes.data
    found = junk = 0
    used = -1
    previous = start  # the end of the last record
    probe = start + 8
    in_line = True  # the next frame is where the last record says it is
    while found < runs.shape[0] and (in_line or probe + 8 <= size):
        head, number, end = _header(base, size, probe)
        which = np.int16(UNKNOWN)
        if head and number < slots.shape[0]:
            which = slots[number]
        good = False
        if which >= 0:
            tail = probe + head + np.int64(_byte(base + probe + 1))
            sent = _byte(base + tail) | _byte(base + tail + 1) << np.uint64(8)
            good = _crc(base + probe + 1, base + tail, extras[which], tables) == sent
        elif head and probe == previous + 8:
            good = _follows(base, size, probe, end)
        if not good:
            # A lost byte may lie in the stamp: then the frame starts early, so look from its start.
            probe = previous if in_line else probe + 1
            in_line = False
            continue
        if not in_line or used < 0:
            used += 1
            runs[used, 0] = probe
            runs[used, 1] = 0
            junk += probe - 8 - previous if probe - 8 >= previous else probe - previous
        runs[used, 1] += 1
        if which >= 0:
            counts[which] += 1
        found += 1
        previous = end
        probe = end + 8
        in_line = True
    if found < runs.shape[0]:
        return used + 1, size, junk + size - previous
    return used + 1, previous, junk


@njit(cache=True, nogil=True, inline="always")
def _next(base, runs, run, place, end):
    """The frame after the one at `place` of a run that ends at `end`.

    Its run, place, address (-1: there is none) and stamp (-1: its bytes are not all there).
    """
    if place + 1 < runs[run, 1]:
        return run, place + 1, end + 8, _stamp(base + end)
    if run + 1 == runs.shape[0]:
        return run + 1, 0, np.int64(-1), np.int64(-1)
    at = runs[run + 1, 0]
    return run + 1, 0, at, _stamp(base + at - 8) if at - 8 >= end else np.int64(-1)


@njit(cache=True, nogil=True, inline="always")
def _lone(stamp, before, after):
    """Whether a stamp is missing or far from both its neighbours, which are near each other.

    A clock that jumps and stays there is no damage.
    """
    return stamp < 0 or (
        abs(stamp - before) > SLIP_US
        and after >= 0
        and abs(stamp - after) > SLIP_US
        and abs(after - before) < SLIP_US
    )


@njit(cache=True, nogil=True)
def first_stamp(data, runs):
    """The first stamp that its successor confirms, else the first there is, else 0."""
    base = data.ctypes.data
    size = data.shape[0]
    run = place = 0
    first = stamp = np.int64(-1)
    at = np.int64(-1)
    if runs.shape[0]:
        at = runs[0, 0]
        stamp = _stamp(base + at - 8) if at >= 8 else stamp
    while at >= 0:
        _, _, end = _header(base, size, at)
        before = stamp
        run, place, at, stamp = _next(base, runs, run, place, end)
        if before >= 0 and stamp >= 0 and abs(stamp - before) <= SLIP_US:
            return before
        first = max(first, before) if first < 0 else first
    return max(first, np.int64(0))


@njit(cache=True, nogil=True)
def unroll(data, runs, slots, from_, at, t_us, slot):
    """One entry per frame, until the arrays are full or the runs at an end.

    Parameters
    ----------
    data, slots
        As for `walk`.
    runs : int64 array (m, 2)
        As `walk` filled it.
    from_ : tuple of int
        Run and place in it to begin with, where the frame before ended, and its stamp; in the
        beginning (0, 0, 0, `first_stamp`).
    at, t_us, slot : int64, int64, int16 arrays
        Filled: start of the frame, stamp, slot. A damaged stamp is replaced by the one before.

    Returns
    -------
    tuple
        Entries filled, and what `from_` is to be for the rest.
    """
    base = data.ctypes.data
    size = data.shape[0]
    run, place, end, good = from_
    filled = 0
    probe = stamp = np.int64(-1)
    if run < runs.shape[0]:
        probe = runs[run, 0] if place == 0 else end + 8
        stamp = _stamp(base + probe - 8) if probe - 8 >= end else stamp
    while filled < at.shape[0] and probe >= 0:
        _, number, end = _header(base, size, probe)
        at[filled] = probe
        slot[filled] = slots[number] if number < slots.shape[0] else np.int16(UNKNOWN)
        run, place, probe, after = _next(base, runs, run, place, end)
        if not _lone(stamp, good, after):
            good = stamp
        t_us[filled] = good
        stamp = after
        filled += 1
    return filled, (run, place, end, good)


@njit(cache=True, nogil=True)
def scatter(data, at, t_us, slot, lengths, nexts, rows):
    """Copy header and payload of each frame to the next row of its message.

    Parameters
    ----------
    data, at, t_us, slot
        As `unroll` filled them.
    lengths : int64 array
        Full payload length of each slot, -1 for one that is not wanted.
    nexts : int64 array
        Where in `rows` the next row of each slot goes; moved on.
    rows : uint8 array
        Zeros, filled with packed rows of `HEAD` bytes and the payload, cut zeros put back. `SLACK`
        bytes must follow the last row of each slot: a row's last store may reach seven bytes into
        the next row, which is written later.
    """
    source = data.ctypes.data
    target = rows.ctypes.data
    size = data.shape[0]
    for i in range(at.shape[0]):
        which = slot[i]
        if which < 0 or lengths[which] < 0:
            continue
        begin = source + at[i]
        to = target + nexts[which]
        length = lengths[which]
        nexts[which] += HEAD + length
        second = _byte(begin) == 0xFD
        sender = begin + (5 if second else 3)
        _store64(np.uint64(to), np.uint64(t_us[i]))
        _store8(np.uint64(to + 8), _load8(np.uint64(sender)))
        _store8(np.uint64(to + 9), _load8(np.uint64(sender + 1)))
        _store8(np.uint64(to + 10), _load8(np.uint64(sender - 1)))
        come = min(length, np.int64(_byte(begin + 1)))
        payload = begin + (10 if second else 6)
        to += HEAD
        k = 0
        while k + 8 <= come:
            _store64(np.uint64(to + k), _load64(np.uint64(payload + k)))
            k += 8
        if k < come and payload + k + 8 <= source + size:
            mask = (np.uint64(1) << np.uint64(8 * (come - k))) - np.uint64(1)
            _store64(np.uint64(to + k), _load64(np.uint64(payload + k)) & mask)
        else:
            while k < come:
                _store8(np.uint64(to + k), _load8(np.uint64(payload + k)))
                k += 1
