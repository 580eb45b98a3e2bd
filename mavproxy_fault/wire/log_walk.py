"""The compiled walk over a log's bytes: where the frames are, and their payloads into columns.

Importing this file imports numba (half a second); the compiled code is cached on disk. The kernels
release the interpreter's lock. They read and write memory eight bytes at a time by address: what
bounds each access is said beside it.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.wire.framing import (
    big_endian64,
    byte_at,
    frame_header,
    has_valid_checksum,
    inline_in_kernels,
    load8,
    load64,
    store8,
    store64,
)

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]

HEAD = 11  # bytes of a row before the payload: t_us, system, component, seq
SLACK = 16  # bytes that must follow the rows of each message: stores are eight bytes wide
UNKNOWN = -1  # the slot of a frame whose message the dialect does not know
NEAR_US = 1 << 36  # two neighbouring stamps further apart than this (19 h) do not belong together
SLIP_US = 60_000_000  # a stamp this far from its neighbours may be damaged


class LogMessages(NamedTuple):
    """The layout of the dialect's messages, each of which has a slot.

    `slots` has the slot of each message id, -1 where it is unknown, shape (ids,); ids beyond are
    unknown too. `extras` are the CRC extras by slot, `lengths` the full payloads in bytes, shape
    (slots,); `tables` are those of `numerics.crc`, shape (8, 256).
    """

    slots: NDArray[np.int16]
    extras: NDArray[np.uint64]
    lengths: Integers
    tables: NDArray[np.uint16]


class LogFrames(NamedTuple):
    """Frames of a log: where each starts, its stamp in microseconds and its slot, shape (n,)."""

    at: Integers
    t_us: Integers
    slot: NDArray[np.int16]


Resume = tuple[int, int, int, int]


@inline_in_kernels
def _follows(base: Any, size: Any, at: Any, end: Any) -> Any:
    """Whether a further record, stamped near the one whose frame is at `at`, starts at `end`."""
    # At the end of the log nothing can follow, which proves nothing against the frame.
    if end + 9 > size:
        return True
    first = byte_at(base + end + 8)
    if first != 0xFE and first != 0xFD:
        return False
    return abs(big_endian64(base + end) - big_endian64(base + at - 8)) < NEAR_US


@inline_in_kernels
def _record(base: Any, size: Any, probe: Any, previous: Any, messages: Any) -> Any:
    """Whether a frame is at `probe`, its slot and its end.

    A message that the dialect does not know has no checksum to verify: it counts as a frame only
    between a record that ended at `previous` and one that follows.
    """
    head, number, end = frame_header(base, size, probe)
    slot = np.int16(UNKNOWN)
    if head and number < messages.slots.shape[0]:
        slot = messages.slots[number]
    good = False
    if slot >= 0:
        good = has_valid_checksum(base, probe, head, messages.extras[slot], messages.tables)
    elif head and probe == previous + 8:
        good = _follows(base, size, probe, end)
    return good, slot, end


@compiled
def walk(
    data: Bytes, start: int, messages: LogMessages, runs: Integers, counts: Integers
) -> tuple[int, int, int]:
    """Find frames from byte `start` on until `runs` could overflow or the data ends.

    Where a record does not verify, every later byte is tried as the start of a frame, so that one
    broken record costs no intact one.

    Parameters
    ----------
    data : uint8 array, shape (n,)
        The log.
    start : int
        Where the previous record ended.
    messages : LogMessages
        What is known of the dialect.
    runs : int64 array, shape (m, 2)
        Filled: where a frame starts that is followed by others record upon record, and how many
        they are with it. At most m frames are looked for.
    counts : int64 array, shape (slots,)
        Frames of each slot, counted up.

    Returns
    -------
    tuple
        Runs found, where to go on (the data's length at its end), bytes belonging to no record.
    """
    size, base = data.shape[0], data.ctypes.data
    found = junk = 0
    used = -1
    previous, probe = start, start + 8  # the end of the last record, and where a frame may begin
    in_line = True  # the next frame is where the last record says it is
    while found < runs.shape[0] and (in_line or probe + 8 <= size):
        good, slot, end = _record(base, size, probe, previous, messages)
        if not good:
            # A lost byte may lie in the stamp: then the frame starts early, so look from its start.
            probe = previous if in_line else probe + 1
            in_line = False
            continue
        if not in_line or used < 0:
            used += 1
            # A run costs one row however long it is: intact logs have one.
            runs[used, 0], runs[used, 1] = probe, 0
            junk += probe - 8 - previous if probe - 8 >= previous else probe - previous
        runs[used, 1] += 1
        if slot >= 0:
            counts[slot] += 1
        found += 1
        previous, probe = end, end + 8
        in_line = True
    if found < runs.shape[0]:
        return used + 1, size, junk + size - previous
    return used + 1, previous, junk


@inline_in_kernels
def _next(base: Any, runs: Any, run: Any, place: Any, end: Any) -> Any:
    """The frame after the one at `place` of a run that ends at `end`.

    Its run, place, address (-1: there is none) and stamp (-1: its bytes are not all there).
    """
    if place + 1 < runs[run, 1]:
        return run, place + 1, end + 8, big_endian64(base + end)
    if run + 1 == runs.shape[0]:
        return run + 1, 0, np.int64(-1), np.int64(-1)
    at = runs[run + 1, 0]
    return run + 1, 0, at, big_endian64(base + at - 8) if at - 8 >= end else np.int64(-1)


@inline_in_kernels
def _lone(stamp: Any, before: Any, after: Any) -> Any:
    """Whether a stamp is missing or far from both its neighbours, which are near each other.

    A clock that jumps and stays there is not damage.
    """
    return stamp < 0 or (
        abs(stamp - before) > SLIP_US
        and after >= 0
        and abs(stamp - after) > SLIP_US
        and abs(after - before) < SLIP_US
    )


@compiled
def first_stamp(data: Bytes, runs: Integers) -> Any:
    """The first stamp that its successor confirms, else the first there is, else 0."""
    base = data.ctypes.data
    size = data.shape[0]
    run = place = 0
    first = stamp = np.int64(-1)
    at = np.int64(-1)
    if runs.shape[0]:
        at = runs[0, 0]
        stamp = big_endian64(base + at - 8) if at >= 8 else stamp
    while at >= 0:
        _, _, end = frame_header(base, size, at)
        before = stamp
        run, place, at, stamp = _next(base, runs, run, place, end)
        if before >= 0 and stamp >= 0 and abs(stamp - before) <= SLIP_US:
            return before
        # Not confirmed, but better than none.
        first = max(first, before) if first < 0 else first
    return max(first, np.int64(0))


@compiled
def unroll(
    data: Bytes, runs: Integers, messages: LogMessages, resume: Resume, frames: LogFrames
) -> tuple[int, Any]:
    """One entry per frame, until the arrays are full or the runs at an end.

    Parameters
    ----------
    data, messages
        As for `walk`.
    runs : int64 array, shape (m, 2)
        As `walk` filled it.
    resume : tuple of int
        Run and place in it to begin with, where the frame before ended, and its stamp; in the
        beginning (0, 0, 0, `first_stamp`).
    frames : LogFrames
        Filled. A damaged stamp is replaced by the one before.

    Returns
    -------
    tuple
        Entries filled, and what `resume` is to be for the rest.
    """
    base = data.ctypes.data
    size = data.shape[0]
    run, place, end, good = resume
    at, t_us, slot = frames.at, frames.t_us, frames.slot
    slots = messages.slots
    filled = 0
    probe: Any = np.int64(-1)
    stamp: Any = np.int64(-1)
    if run < runs.shape[0]:
        # Inside a run the next frame starts eight bytes of stamp behind the one before.
        probe = runs[run, 0] if place == 0 else end + 8
        stamp = big_endian64(base + probe - 8) if probe - 8 >= end else stamp
    while filled < at.shape[0] and probe >= 0:
        _, number, end = frame_header(base, size, probe)
        at[filled] = probe
        slot[filled] = slots[number] if number < slots.shape[0] else np.int16(UNKNOWN)
        run, place, probe, after = _next(base, runs, run, place, end)
        # Otherwise the stamp before is given once more.
        if not _lone(stamp, good, after):
            good = stamp
        t_us[filled] = good
        stamp = after
        filled += 1
    return filled, (run, place, end, good)


@compiled
def scatter(
    data: Bytes, frames: LogFrames, lengths: Integers, nexts: Integers, rows: Bytes
) -> None:
    """Copy header and payload of each frame to the next row of its message.

    Parameters
    ----------
    data : uint8 array, shape (n,)
        The log.
    frames : LogFrames
        As `unroll` filled them.
    lengths : int64 array, shape (slots,)
        Full payload length of each slot in bytes, -1 for one that is not wanted.
    nexts : int64 array, shape (slots,)
        Where in `rows` the next row of each slot goes; moved on.
    rows : uint8 array
        Zeros, filled with packed rows of `HEAD` bytes and the payload, cut zeros put back. `SLACK`
        bytes must follow the last row of each slot: a row's last store may reach seven bytes into
        the next row, which is written later.
    """
    source = data.ctypes.data
    target = rows.ctypes.data
    at, t_us, slot = frames.at, frames.t_us, frames.slot
    size = data.shape[0]
    for i in range(at.shape[0]):
        which = slot[i]
        if which < 0 or lengths[which] < 0:
            continue
        begin = source + at[i]
        to = target + nexts[which]
        length = lengths[which]
        nexts[which] += HEAD + length
        second = byte_at(begin) == 0xFD
        sender = begin + (5 if second else 3)
        # Row and field are packed, so that nothing here is aligned; x86 and ARM bear that.
        store64(np.uint64(to), np.uint64(t_us[i]))
        store8(np.uint64(to + 8), load8(np.uint64(sender)))
        store8(np.uint64(to + 9), load8(np.uint64(sender + 1)))
        store8(np.uint64(to + 10), load8(np.uint64(sender - 1)))
        # A newer dialect may send more bytes than ours has fields for.
        come = min(length, np.int64(byte_at(begin + 1)))
        payload = begin + (10 if second else 6)
        to += HEAD
        k = 0
        while k + 8 <= come:
            store64(np.uint64(to + k), load64(np.uint64(payload + k)))
            k += 8
        # Eight bytes at once if the file has as many; those that are not ours are masked off.
        if k < come and payload + k + 8 <= source + size:
            mask = (np.uint64(1) << np.uint64(8 * (come - k))) - np.uint64(1)
            store64(np.uint64(to + k), load64(np.uint64(payload + k)) & mask)
        else:
            while k < come:
                store8(np.uint64(to + k), load8(np.uint64(payload + k)))
                k += 1
