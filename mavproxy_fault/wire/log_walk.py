"""The compiled walk over a log's bytes: where the frames are, and their payloads into columns.

Importing this file imports numba (half a second); the compiled code is cached on disk. The kernels
release the interpreter's lock. They read and write memory eight bytes at a time by address: what
bounds each access is said beside it.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.wire import frame
from mavproxy_fault.wire.framing import (
    big_endian64,
    byte_at,
    has_valid_checksum,
    inline_in_kernels,
    load8,
    load64,
    store8,
    store64,
)

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]

frame_header = inline_in_kernels(frame.frame_header)
has_unknown_flags = inline_in_kernels(frame.has_unknown_flags)

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
    """Frames of a log: where each starts, its stamp in microseconds, where it ends and its slot,
    shape (n,)."""

    at: Integers
    t_us: Integers
    end: Integers
    slot: NDArray[np.int16]


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
def _record(data: Any, base: Any, probe: Any, previous: Any, messages: Any) -> Any:
    """Whether a frame is at `probe`, its slot and its end.

    A message that the dialect does not know has no checksum to verify: it counts as a frame only
    between a record that ended at `previous` and one that follows.
    """
    size = data.shape[0]
    head, number, end = frame_header(data, probe, size)
    if head and (end > size or has_unknown_flags(data, probe)):
        head = 0
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
def walk(data: Bytes, start: int, messages: LogMessages, frames: LogFrames) -> tuple[int, int, int]:
    """Find frames from byte `start` on until `frames` is full or the data ends.

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
    frames : LogFrames
        Filled; the stamp is -1 where its bytes are not all there.

    Returns
    -------
    tuple
        Frames found, where to go on (the data's length at its end), bytes belonging to no record.
    """
    size, base = data.shape[0], data.ctypes.data
    found = junk = 0
    previous, probe = start, start + 8  # the end of the last record, and where a frame may begin
    in_line = True  # the next frame is where the last record says it is
    while found < frames.at.shape[0] and (in_line or probe + 8 <= size):
        good, slot, end = _record(data, base, probe, previous, messages)
        if not good:
            # A lost byte may lie in the stamp: then the frame starts early, so look from its start.
            probe = previous if in_line else probe + 1
            in_line = False
            continue
        stamped = probe - 8 >= previous
        junk += probe - 8 - previous if stamped else probe - previous
        frames.at[found], frames.end[found], frames.slot[found] = probe, end, slot
        frames.t_us[found] = big_endian64(base + probe - 8) if stamped else np.int64(-1)
        found += 1
        previous, probe = end, end + 8
        in_line = True
    if found < frames.at.shape[0]:
        return found, size, junk + size - previous
    return found, previous, junk


@compiled
def repair_stamps(t_us: Integers) -> None:
    """Replace stamps (n,) that are missing (negative), or far from both their neighbours while
    these are near each other, by the one before.

    A clock that jumps and stays there is not damage. Before the first stamp holds the first that
    its successor confirms, else the first there is.
    """
    count = t_us.shape[0]
    good = np.int64(-1)
    for i in range(count):
        confirmed = i + 1 < count and t_us[i + 1] >= 0 and abs(t_us[i + 1] - t_us[i]) <= SLIP_US
        if t_us[i] >= 0 and (confirmed or good < 0):
            good = t_us[i]
            if confirmed:
                break
    good = max(good, np.int64(0))
    for i in range(count):
        after = t_us[i + 1] if i + 1 < count else np.int64(-1)
        alone = abs(t_us[i] - good) > SLIP_US and abs(t_us[i] - after) > SLIP_US
        if t_us[i] < 0 or (alone and after >= 0 and abs(after - good) < SLIP_US):
            t_us[i] = good
        good = t_us[i]


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
        As `walk` filled them.
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
    at, t_us, _, slot = frames
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
