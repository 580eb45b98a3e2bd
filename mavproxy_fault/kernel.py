"""The compiled path: whole datagrams from socket to socket, verified, patched and counted.

It takes only what is plain: known senders on UDP links, whole frames with right CRCs and no
signature, messages that no fault or only constant and linearly growing faults act on. At anything
else it stops and hands that datagram to the plain path; both work on the same memory (`memory`),
so order and state stay exact. Here are the frames, in `pump` the sockets. Importing this file
imports numba; the machine code is cached on disk, by `pump.py`'s date alone: after a change here or
in `memory`, touch that file too.

Arrays travel in two tuples, `wire` (data, memory, table, plans, three logs, numbers, hits, steps,
CRC tables, result) and `net` (ports, heads, headers, parts, names, peers, name lengths, heard).
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
import numpy as np
from fastcrc.crc16 import mcrf4xx
from numba import njit
from numpy.typing import NDArray

from mavproxy_fault.clock import NEAR_US, UNIX_FROM_US
from mavproxy_fault.memory import (
    GAPS,
    LEAD,
    LINKS,
    NEWEST,
    NEXT_SEQ,
    NOW,
    SHIFT,
    SPEAKER,
    SYSTEM_LINKS,
    SYSTEM_TIME,
    UNKNOWN,
)
from mavproxy_fault.wire.frame import FLOAT_MAX

BATCH = 64  # datagrams per system call
ROW = 65_536  # bytes kept for each
PEERS = 32
NAME = 32  # bytes kept for a socket address

# Columns of `table`, by message id
KIND, EXTRA, STAMP_AT, STAMP_SIZE, STAMP_SCALE, TARGET_SYSTEM, TARGET_COMPONENT, PLAN = range(8)
PLAIN, PASS, PASS_UNTIL_EDGE, PLANNED = range(4)  # kinds
# Columns of `plans`, a row per element; the first row of a fault also says whom it is for
OFFSET, CODE, MODE, ROWS, SYSTEM, COMPONENT, DIRECTION, START = range(8)
ADD, SCALE, REPLACE, GROW = range(4)  # modes
VALUE, LIMIT = range(2)  # columns of `numbers`
FRAMES_HIT, SATURATED, LAST = range(3)  # columns of `hits`
# Columns of `ports`, a row per link
FD, FAST, LISTENS, PEER_COUNT, FROM_VEHICLE = range(5)
DATAGRAMS, BYTES, FRAMES, MISSING, FAULTED, SENT, BYTES_SENT, DROPS, ERRORS = range(5, 14)
# Entries of `turn`
DEADLINE, BASE, SPIN, LINK, AT, COUNT, EDGE, WANTED_AT, POLLS, KEEP = range(10)
RECEIVED_AT, SENT_AT, INDEX_AT, SECONDS, NANOSECONDS, HITS = range(10, 16)
TIME_IS_UP, NOT_PLAIN, OTHER_READY, LOG_FULL = range(4)  # why it returns

LOG_SIZE = 1 << 24
LOG_MARGIN = 1 << 23  # more than a batch of the smallest frames in the largest datagrams


def crc_tables() -> NDArray[np.int64]:
    """Slicing tables, shape (8, 256): entry [n, b] is the CRC of byte b followed by n zeros."""
    tables = np.zeros((8, 256), np.int64)
    tables[0] = [mcrf4xx(bytes((byte,)), 0) for byte in range(256)]
    for n in range(1, 8):
        tables[n] = tables[n - 1] >> 8 ^ tables[0, tables[n - 1] & 0xFF]
    return tables


@njit(cache=True, nogil=True, inline="always")
def _little(data, at, size):
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(data[at + k]) << (8 * k)
    return value


@njit(cache=True, nogil=True)
def _crc(data, start, stop, extra, tables):
    """CRC of some bytes and the CRC extra, eight bytes a step by slicing tables."""
    crc = np.int64(0xFFFF)
    at = start
    while at + 8 <= stop:
        crc ^= np.int64(data[at]) | np.int64(data[at + 1]) << 8
        crc = (
            tables[7, crc & 0xFF]
            ^ tables[6, crc >> 8]
            ^ tables[5, data[at + 2]]
            ^ tables[4, data[at + 3]]
            ^ tables[3, data[at + 4]]
            ^ tables[2, data[at + 5]]
            ^ tables[1, data[at + 6]]
            ^ tables[0, data[at + 7]]
        )
        at += 8
    while at < stop:
        crc = crc >> 8 ^ tables[0, (crc ^ data[at]) & 0xFF]
        at += 1
    return crc >> 8 ^ tables[0, (crc ^ extra) & 0xFF]


@njit(cache=True, nogil=True)
def _stamp(data, payload, length, entry):
    """The stamp of a frame in microseconds, 0 without one; cut zeros read as 0."""
    if entry[STAMP_AT] < 0:
        return np.int64(0)
    size = min(entry[STAMP_SIZE], length - entry[STAMP_AT])
    return _little(data, payload + entry[STAMP_AT], size) * entry[STAMP_SCALE]


@njit(cache=True, nogil=True)
def _time(stamp, sender, memory):
    """Vehicle time of a frame; UNKNOWN where its clock is new or was set back."""
    if stamp == 0:
        latest = memory[SYSTEM_TIME + (sender >> 8)]
        return memory[NOW] if latest == UNKNOWN else latest
    clock = sender << 1 | np.int64(stamp >= UNIX_FROM_US)
    shift = memory[SHIFT + clock]
    if shift == UNKNOWN or stamp < memory[NEWEST + clock] - NEAR_US:
        return np.int64(UNKNOWN)
    return stamp + shift


@njit(cache=True, nogil=True)
def _links(data, payload, length, entry, memory, everywhere, bit):
    """Where a frame goes, as `routing.Routes.find`."""
    others = everywhere & ~bit
    at = entry[TARGET_SYSTEM]
    if at < 0 or at >= length or data[payload + at] == 0:
        return others
    system = np.int64(data[payload + at])
    at = entry[TARGET_COMPONENT]
    component = np.int64(data[payload + at]) if 0 <= at < length else np.int64(0)
    exact = memory[LINKS + (system << 8 | component)]
    if exact:
        return exact & others
    found = memory[SYSTEM_LINKS + system] & others
    return found if found else others


@njit(cache=True, nogil=True)
def check(start, length, bit, fast, everywhere, turn, wire):
    """The links a datagram goes to, -1 if it is not plain."""
    data, memory, table, plans, tables = wire[0], wire[1], wire[2], wire[3], wire[10]
    at, end = start, start + length
    mask = np.int64(-1)
    while at < end:
        if data[at] == 0xFD and at + 12 <= end and data[at + 2] == 0:
            head, number = 10, _little(data, at + 7, 3)
            sender = np.int64(data[at + 5]) << 8 | np.int64(data[at + 6])
        elif data[at] == 0xFE and at + 8 <= end:
            head, number = 6, np.int64(data[at + 5])
            sender = np.int64(data[at + 3]) << 8 | np.int64(data[at + 4])
        else:
            return -1
        size = np.int64(data[at + 1])
        tail = at + head + size
        if tail + 2 > end or number >= table.shape[0] or memory[LINKS + sender] != bit:
            return -1
        entry = table[number]
        if entry[KIND] == PLAIN:
            return -1
        if _crc(data, at + 1, tail, entry[EXTRA], tables) != _little(data, tail, 2):
            return -1
        t_us = _time(_stamp(data, at + head, size, entry), sender, memory)
        if t_us == UNKNOWN or (entry[KIND] != PASS and t_us >= turn[EDGE]):
            return -1
        if entry[KIND] == PLANNED:
            first = entry[PLAN]
            for row in range(first, first + plans[first, ROWS]):
                if plans[row, OFFSET] + _size(plans[row, CODE]) > size:
                    return -1
        found = _links(data, at + head, size, entry, memory, everywhere, bit)
        if found & ~fast or (mask >= 0 and found != mask):
            return -1
        mask = found
        at = tail + 2
    return mask


@njit(cache=True, nogil=True, inline="always")
def _size(code):
    if code == 98 or code == 66:  # b, B
        return 1
    if code == 104 or code == 72:  # h, H
        return 2
    return 8 if code == 100 else 4  # d; f, i, I


@njit(cache=True, nogil=True)
def _faulty(old, mode, value, limit, t_s):
    if mode == ADD:
        return old + value
    if mode == SCALE:
        return old * value
    if mode == REPLACE:
        return value
    return old + max(-limit, min(limit, value * t_s))


@njit(cache=True, nogil=True)
def _patch_element(data, at, code, mode, value, limit, t_s, result):
    """Change one element; size of the step and whether it was saturated go to `result`."""
    size = _size(code)
    before = _little(data, at, size)
    result[1] = 0.0
    if code == 102:
        floats = data[at : at + 4].view(np.float32)
        old = np.float64(floats[0])
        new = _faulty(old, mode, value, limit, t_s)
        if np.isfinite(new) and abs(new) > FLOAT_MAX:
            result[1] = 1.0
            new = FLOAT_MAX if new > 0 else -FLOAT_MAX
        floats[0] = np.float32(new)
        result[0] = abs(np.float64(floats[0]) - old)
    elif code == 100:
        doubles = data[at : at + 8].view(np.float64)
        old = doubles[0]
        doubles[0] = _faulty(old, mode, value, limit, t_s)
        result[0] = abs(doubles[0] - old)
    else:
        bits = 8 * size
        signed = code > 96  # lower case
        integer = before
        if signed and before >> (bits - 1):
            integer = before - (np.int64(1) << bits)
        low = -(np.int64(1) << (bits - 1)) if signed else np.int64(0)
        high = (np.int64(1) << (bits - 1 if signed else bits)) - 1
        new = _faulty(np.float64(integer), mode, value, limit, t_s)
        if np.isnan(new):
            stored = np.int64(0)
            result[1] = 1.0
        else:
            rounded = np.rint(new)
            result[1] = 0.0 if low <= rounded <= high else 1.0
            stored = low if new <= low else high if new >= high else np.int64(rounded)
        for k in range(size):
            data[at + k] = stored >> (8 * k) & 0xFF
        result[0] = abs(np.float64(stored - integer))
    return _little(data, at, size) != before


@njit(cache=True, nogil=True)
def _patch(at, head, size, entry, t_us, wire):
    """Apply one planned fault to a frame; whether a byte changed."""
    data, plans, (numbers, hits, steps, tables, result) = wire[0], wire[3], wire[7:]
    first, extra = entry[PLAN], entry[EXTRA]
    changed = False
    saturated = 0
    step = -1.0
    t_s = (t_us - plans[first, START]) / 1e6
    for row in range(first, first + plans[first, ROWS]):
        changed |= _patch_element(
            data,
            at + head + plans[row, OFFSET],
            plans[row, CODE],
            plans[row, MODE],
            numbers[row, VALUE],
            numbers[row, LIMIT],
            t_s,
            result,
        )
        saturated += int(result[1])
        if np.isfinite(result[0]):
            step = max(step, result[0])
    if changed:
        hits[first, FRAMES_HIT] += 1
        hits[first, SATURATED] += saturated
        hits[first, LAST] = t_us
        steps[first] = max(steps[first], step)
        tail = at + head + size
        crc = _crc(data, at + 1, tail, extra, tables)
        data[tail] = crc & 0xFF
        data[tail + 1] = crc >> 8
    return changed


@njit(cache=True, nogil=True)
def _is_for(plan, sender, from_vehicle):
    """Whether a planned fault's `where` lets the sender through."""
    return (
        (plan[SYSTEM] < 0 or plan[SYSTEM] == sender >> 8)
        and (plan[COMPONENT] < 0 or plan[COMPONENT] == sender & 0xFF)
        and (plan[DIRECTION] < 0 or plan[DIRECTION] == from_vehicle)
    )


@njit(cache=True, nogil=True)
def _log(log, place, turn, now_us, data, at, length):
    """Append one record to a log; `place` is the entry of `turn` that counts its bytes."""
    start = turn[place]
    for k in range(8):
        log[start + k] = now_us >> (56 - 8 * k) & 0xFF
    log[start + 8 : start + 8 + length] = data[at : at + length]
    turn[place] = start + 8 + length


@njit(cache=True, nogil=True)
def take(start, length, link, mask, now_us, ports, turn, wire):
    """Count, patch and record the frames of one plain datagram."""
    data, memory, table, plans, received, sent, index = wire[:7]
    at, end = start, start + length
    while at < end:
        if data[at] == 0xFD:
            head, number, seq = 10, _little(data, at + 7, 3), np.int64(data[at + 4])
            sender = np.int64(data[at + 5]) << 8 | np.int64(data[at + 6])
        else:
            head, number, seq = 6, np.int64(data[at + 5]), np.int64(data[at + 2])
            sender = np.int64(data[at + 3]) << 8 | np.int64(data[at + 4])
        size = np.int64(data[at + 1])
        whole = head + size + 2
        entry = table[number]
        ports[link, FRAMES] += 1
        expected = memory[NEXT_SEQ + sender]
        if expected != UNKNOWN and seq != expected:
            missing = (seq - expected) & 0xFF
            memory[GAPS + sender] += missing
            ports[link, MISSING] += missing
        memory[NEXT_SEQ + sender] = (seq + 1) & 0xFF
        if ports[link, FROM_VEHICLE]:
            memory[SPEAKER] = sender >> 8
        stamp = _stamp(data, at + head, size, entry)
        t_us = _time(stamp, sender, memory)
        if stamp:
            memory[NEWEST + (sender << 1 | np.int64(stamp >= UNIX_FROM_US))] = stamp
            memory[NOW] = t_us
            memory[SYSTEM_TIME + (sender >> 8)] = t_us
        memory[LEAD] = now_us - t_us
        if turn[KEEP]:
            place = turn[INDEX_AT]
            index[place] = link
            index[place + 1] = 0
            for k in range(4):
                index[place + 2 + k] = whole >> (8 * k) & 0xFF
            turn[INDEX_AT] = place + 6
            _log(received, RECEIVED_AT, turn, now_us, data, at, whole)
        if entry[KIND] != PASS:
            turn[WANTED_AT] = t_us
        if entry[KIND] == PLANNED and _is_for(
            plans[entry[PLAN]], sender, ports[link, FROM_VEHICLE]
        ):
            changed = _patch(at, head, size, entry, t_us, wire)
            ports[link, FAULTED] += changed
            turn[HITS] |= changed
        if turn[KEEP] and mask:
            _log(sent, SENT_AT, turn, now_us, data, at, whole)
        at += whole
