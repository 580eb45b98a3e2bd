"""The compiled walk over a log's bytes: where the frames are, and their payloads into columns.

Importing this file imports numba (half a second); the compiled code is cached on disk. Both kernels
release the interpreter's lock. The CRC (CRC-16/MCRF4XX, reflected polynomial 0x8408) goes eight
bytes a step by eight tables ("slicing-by-8" [1]_).

References
----------
.. [1] Kounavis and Berry, "A Systematic Approach to Building High Performance Software-based CRC
       Generators", ISCC 2005.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
import numpy as np
from numba import njit
from numpy.typing import NDArray

STAMP = 8  # bytes of the big-endian microseconds before each frame
HEAD = 11  # bytes of a row before the payload: t_us, system, component, seq
UNKNOWN = -1  # the slot of a frame whose message the dialect does not know
NEAR_US = 1 << 36  # two neighbouring stamps further apart than this (19 h) do not belong together


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


@njit(cache=True, nogil=True, inline="always")
def _crc(data, start, stop, extra, tables):
    crc = 0xFFFF
    at = start
    while at + 8 <= stop:
        crc ^= np.int64(data[at]) | np.int64(data[at + 1]) << 8
        crc = (
            np.int64(tables[7, crc & 0xFF])
            ^ np.int64(tables[6, crc >> 8])
            ^ np.int64(tables[5, data[at + 2]])
            ^ np.int64(tables[4, data[at + 3]])
            ^ np.int64(tables[3, data[at + 4]])
            ^ np.int64(tables[2, data[at + 5]])
            ^ np.int64(tables[1, data[at + 6]])
            ^ np.int64(tables[0, data[at + 7]])
        )
        at += 8
    while at < stop:
        crc = (crc >> 8) ^ np.int64(tables[0, (crc ^ np.int64(data[at])) & 0xFF])
        at += 1
    return (crc >> 8) ^ np.int64(tables[0, (crc ^ extra) & 0xFF])


@njit(cache=True, nogil=True, inline="always")
def _stamp(data, at):
    value = np.int64(0)
    for i in range(8):
        value = value << 8 | np.int64(data[at + i])
    return value


@njit(cache=True, nogil=True, inline="always")
def _header(data, at):
    """Bytes before the payload, message id and end of a frame at `at`; zeros if none is."""
    size = data.shape[0]
    if at + 8 > size:
        return 0, 0, 0
    if data[at] == 0xFE:
        head, number, tail = 6, np.int64(data[at + 5]), 2
    elif data[at] == 0xFD and at + 12 <= size and data[at + 2] <= 1:
        number = np.int64(data[at + 7]) | np.int64(data[at + 8]) << 8 | np.int64(data[at + 9]) << 16
        head, tail = 10, 2 + 13 * np.int64(data[at + 2])
    else:
        return 0, 0, 0
    end = at + head + np.int64(data[at + 1]) + tail
    if end > size:
        return 0, 0, 0
    return head, number, end


@njit(cache=True, nogil=True, inline="always")
def _follows(data, at, end):
    """Whether a further record, stamped near the one whose frame is at `at`, starts at `end`."""
    size = data.shape[0]
    if end + 9 > size:
        return True
    if data[end + 8] != 0xFE and data[end + 8] != 0xFD:
        return False
    return abs(_stamp(data, end) - _stamp(data, at - 8)) < NEAR_US


@njit(cache=True, nogil=True)
def walk(data, start, slots, extras, tables, at, ends, t_us, slot):
    """Find frames from byte `start` on until the arrays are full or the data ends.

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
    extras : uint8 array
        CRC extra of each slot.
    tables : uint16 array (8, 256)
        From `crc_tables`.
    at, ends, t_us, slot : int64, int64, int64, int16 arrays (m,)
        Filled: start and end of the frame, stamp (-1 if its bytes are not all there), slot.

    Returns
    -------
    tuple
        Frames found, where to go on (the data's length at its end), bytes belonging to no record.
    """
    size = data.shape[0]
    found = 0
    junk = 0
    previous = start  # the end of the last record
    probe = start + 8
    in_line = True  # the next frame is where the last record says it is
    while found < at.shape[0] and (in_line or probe + 8 <= size):
        head, number, end = _header(data, probe)
        which = np.int16(UNKNOWN)
        if head and number < slots.shape[0]:
            which = slots[number]
        good = False
        if which >= 0:
            tail = probe + head + np.int64(data[probe + 1])
            sent = np.int64(data[tail]) | np.int64(data[tail + 1]) << 8
            good = _crc(data, probe + 1, tail, np.int64(extras[which]), tables) == sent
        elif head and probe == previous + 8:
            good = _follows(data, probe, end)
        if not good:
            # A lost byte may lie in the stamp: then the frame starts early, so look from its start.
            probe = previous if in_line else probe + 1
            in_line = False
            continue
        at[found] = probe
        ends[found] = end
        slot[found] = which
        whole = probe - 8 >= previous
        t_us[found] = _stamp(data, probe - 8) if whole else -1
        junk += probe - 8 - previous if whole else probe - previous
        found += 1
        previous = end
        probe = end + 8
        in_line = True
    if found < at.shape[0]:
        return found, size, junk + size - previous
    return found, previous, junk


@njit(cache=True, nogil=True)
def scatter(data, at, t_us, slot, lengths, nexts, rows):
    """Copy header and payload of each frame to the next row of its message.

    Parameters
    ----------
    data, at, t_us, slot
        As `walk` filled them.
    lengths : int64 array
        Full payload length of each slot, -1 for one that is not wanted.
    nexts : int64 array
        Where in `rows` the next row of each slot goes; moved on.
    rows : uint8 array
        Zeros, filled with packed rows of `HEAD` bytes and the payload, cut zeros put back.
    """
    for i in range(at.shape[0]):
        which = slot[i]
        if which < 0 or lengths[which] < 0:
            continue
        begin = at[i]
        version_2 = data[begin] == 0xFD
        to = nexts[which]
        length = lengths[which]
        nexts[which] = to + HEAD + length
        stamp = t_us[i]
        for k in range(8):
            rows[to + k] = np.uint8((stamp >> (8 * k)) & 0xFF)
        source = begin + (5 if version_2 else 3)
        rows[to + 8] = data[source]
        rows[to + 9] = data[source + 1]
        rows[to + 10] = data[source - 1]
        payload = begin + (10 if version_2 else 6)
        for k in range(min(length, np.int64(data[begin + 1]))):
            rows[to + HEAD + k] = data[payload + k]
