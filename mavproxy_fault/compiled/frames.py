"""The compiled path's frames: whole datagrams verified, patched, counted and recorded.

It takes only what is plain: known senders on UDP links, whole frames with right CRCs and no
signature, messages that no fault acts on or only those that `plans` can write down. At anything
else it stops and hands that datagram to the plain path; both work on the same memory
(`proxy.senders`), so order and state stay exact. Here are the frames, in `sockets` the system
calls; `object_file` makes the machine code of both. Importing this file imports numba.

Arrays travel in two tuples, `wire` (data, memory, table, plans, three logs, numbers, hits, steps,
CRC tables, result, pieces, draws) and `net` (ports, heads, headers, parts, names, peers, heard).
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
import numpy as np
from numba import njit

from mavproxy_fault.compiled.layout import (
    ADD,
    BLOCK,
    CODE,
    COMPONENT,
    DIRECTION,
    DRAWN,
    DRAWS_FROM,
    DRY,
    EDGE,
    EXTRA,
    FAULTED,
    FRAMES,
    FRAMES_HIT,
    FROM_VEHICLE,
    GROWS,
    INDEX_AT,
    INSTANCE,
    INSTANCE_AT,
    INSTANCE_SIZE,
    KEEP,
    KIND,
    KNOWN_SENDER,
    KNOWN_WAY,
    LAST,
    LIMIT,
    MISSING,
    MODE,
    NEXT,
    OFFSET,
    OPEN_LEFT,
    PASS,
    PIECES,
    PIECES_FROM,
    PIECES_TO,
    PLAIN,
    PLAN,
    PLANNED,
    RECEIVED_AT,
    ROWS,
    SATURATED,
    SCALE,
    SENT_AT,
    SOURCE,
    STAMP_AT,
    STAMP_SCALE,
    STAMP_SIZE,
    START,
    SYSTEM,
    TARGET_COMPONENT,
    TARGET_SYSTEM,
    USED,
    VALUE,
    WAITS,
    WANTED_AT,
)
from mavproxy_fault.proxy.senders import (
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
from mavproxy_fault.proxy.vehicle_clock import NEAR_US, UNIX_FROM_US
from mavproxy_fault.wire.frame import FLOAT_MAX


@njit(error_model="numpy", forceinline=True)
def _little(data, at, size):
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(data[at + k]) << (8 * k)
    return value


@njit(error_model="numpy", forceinline=True)
def _crc(data, start, stop, extra, tables):
    """CRC of some bytes and the CRC extra, eight bytes a step by slicing tables."""
    crc = np.int64(0xFFFF)
    at = start
    while at + 8 <= stop:
        crc ^= np.int64(data[at]) | np.int64(data[at + 1]) << 8
        crc = np.int64(
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
        crc = crc >> 8 ^ np.int64(tables[0, (crc ^ data[at]) & 0xFF])
        at += 1
    return crc >> 8 ^ np.int64(tables[0, (crc ^ extra) & 0xFF])


@njit(error_model="numpy", forceinline=True)
def _stamp(data, payload, length, entry):
    """The stamp of a frame in microseconds, 0 without one; cut zeros read as 0."""
    if entry[STAMP_AT] < 0:
        return np.int64(0)
    size = min(entry[STAMP_SIZE], length - entry[STAMP_AT])
    return _little(data, payload + entry[STAMP_AT], size) * entry[STAMP_SCALE]


@njit(error_model="numpy", forceinline=True)
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


@njit(error_model="numpy", forceinline=True)
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


@njit(error_model="numpy", forceinline=True)
def check(start, length, bit, fast, from_vehicle, everywhere, turn, wire):
    """The links a datagram goes to, -1 if it is not plain."""
    data, memory, table, tables = wire[0], wire[1], wire[2], wire[10]
    at, end = start, start + length
    mask = np.int64(-1)
    draws = np.int64(0)
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
            drawn = _draws(
                at + head, size, entry[PLAN], sender, from_vehicle, t_us, draws, turn, wire
            )
            if drawn < 0:
                return -1
            draws += drawn
        found = _links(data, at + head, size, entry, memory, everywhere, bit)
        if found & ~fast or (mask >= 0 and found != mask):
            return -1
        mask = found
        at = tail + 2
    return mask


@njit(error_model="numpy", forceinline=True)
def _draws(payload, size, first, sender, from_vehicle, t_us, before, turn, wire):
    """How many drawn numbers the faults of a message need, -1 if one of them is not plain here."""
    data, plans, hits = wire[0], wire[3], wire[8]
    needed = np.int64(0)
    while first >= 0:
        plan = plans[first]
        if _is_for(plan, sender, from_vehicle):
            if plan[KNOWN_SENDER] >= 0 and plan[KNOWN_SENDER] != sender:
                return -1
            if plan[KNOWN_WAY] >= 0 and plan[KNOWN_WAY] != from_vehicle:
                return -1
            if plan[INSTANCE_AT] >= 0:
                length = min(plan[INSTANCE_SIZE], size - plan[INSTANCE_AT])
                if _little(data, payload + plan[INSTANCE_AT], length) != plan[INSTANCE]:
                    return -1
            for row in range(first, first + plan[ROWS]):
                if plans[row, OFFSET] + _size(plans[row, CODE]) > size:
                    return -1
            if plan[WAITS] > 0 and _would_act(payload, first, t_us, wire):
                return -1
            if plan[SOURCE] == DRAWN:
                needed += plan[ROWS]
                if hits[first, USED] + before + needed > BLOCK:
                    turn[DRY] = hits[first, USED]
                    return -1
        first = plan[NEXT]
    return needed


@njit(error_model="numpy", forceinline=True)
def _size(code):
    if code == 98 or code == 66:  # b, B
        return 1
    if code == 104 or code == 72:  # h, H
        return 2
    return 8 if code == 100 else 4  # d; f, i, I


@njit(error_model="numpy", forceinline=True)
def _meet(mode, old, value):
    if mode == ADD:
        return old + value
    return old * value if mode == SCALE else value


@njit(error_model="numpy", forceinline=True)
def _changed(before, code, mode, value, result):
    """The bits of one element after a fault; size of the step and saturation go to `result`."""
    result[1] = 0.0
    if code == 102:
        old = np.float64(np.uint32(before).view(np.float32))
        new = _meet(mode, old, value)
        if np.isfinite(new) and abs(new) > FLOAT_MAX:
            result[1] = 1.0
            new = FLOAT_MAX if new > 0 else -FLOAT_MAX
        single = np.float32(new)
        result[0] = abs(np.float64(single) - old)
        return np.int64(single.view(np.uint32))
    if code == 100:
        double = np.uint64(before).view(np.float64)
        new = _meet(mode, double, value)
        result[0] = abs(new - double)
        return np.int64(np.float64(new).view(np.uint64))
    bits = 8 * _size(code)
    signed = code > 96  # lower case
    integer = before
    if signed and before >> (bits - 1):
        integer = before - (np.int64(1) << bits)
    low = -(np.int64(1) << (bits - 1)) if signed else np.int64(0)
    high = (np.int64(1) << (bits - 1 if signed else bits)) - 1
    new = _meet(mode, np.float64(integer), value)
    stored = np.int64(0)
    if np.isnan(new):
        result[1] = 1.0
    else:
        result[1] = 0.0 if low - 0.5 <= new <= high + 0.5 else 1.0
        stored = low if new <= low else high if new >= high else np.int64(np.rint(new))
    result[0] = abs(np.float64(stored - integer))
    return stored & ((np.int64(1) << bits) - 1)


@njit(error_model="numpy", forceinline=True)
def _piece(plan, otherwise, t_s, pieces):
    """The piecewise-linear function of a plan as in `faults.profile.at`; NaN where it is silent."""
    found = plan[PIECES_FROM] - 1
    for k in range(plan[PIECES_FROM], plan[PIECES_TO]):
        if plan[OPEN_LEFT]:
            if t_s <= pieces[k, 0]:
                break
            found = k
        elif pieces[k, 0] <= t_s:
            found = k
    if found < plan[PIECES_FROM] or not t_s <= pieces[found, 0] + pieces[found, 1]:
        return otherwise
    return pieces[found, 2] + (t_s - pieces[found, 0]) * pieces[found, 3]


@njit(error_model="numpy", forceinline=True)
def _given(plan, row, t_s, wire):
    """The number that meets a row's healthy value; NaN where a function of time is silent."""
    numbers = wire[7]
    value = numbers[row, VALUE]
    if plan[SOURCE] == PIECES:
        return _piece(plan, numbers[row, LIMIT], t_s, wire[12])
    if plan[SOURCE] == GROWS:
        return max(-numbers[row, LIMIT], min(numbers[row, LIMIT], value * t_s))
    return value


@njit(error_model="numpy", forceinline=True)
def _would_act(payload, first, t_us, wire):
    """Whether a fault that has done nothing yet would change a frame: the plain path's to do."""
    data, plans = wire[0], wire[3]
    plan = plans[first]
    if plan[SOURCE] == DRAWN:
        return True
    t_s = (t_us - plan[START]) / 1e6
    for row in range(first, first + plan[ROWS]):
        value = _given(plan, row, t_s, wire)
        code = plans[row, CODE]
        before = _little(data, payload + plans[row, OFFSET], _size(code))
        silent = plan[SOURCE] == PIECES and np.isnan(value)
        if not silent and _changed(before, code, plan[MODE], value, wire[11]) != before:
            return True
    return False


@njit(error_model="numpy", forceinline=True)
def _act(payload, first, t_us, wire):
    """Apply one planned fault to a frame; whether a byte changed."""
    data, plans, hits, steps, result = wire[0], wire[3], wire[8], wire[9], wire[11]
    plan = plans[first]
    t_s = (t_us - plan[START]) / 1e6
    changed = False
    saturated = 0
    step = -1.0
    for row in range(first, first + plan[ROWS]):
        value = _given(plan, row, t_s, wire)
        if plan[SOURCE] == PIECES and np.isnan(value):
            return False
        if plan[SOURCE] == DRAWN:
            value *= wire[13][plan[DRAWS_FROM] + hits[first, USED]]
            hits[first, USED] += 1
        at, code = payload + plans[row, OFFSET], plans[row, CODE]
        size = _size(code)
        before = _little(data, at, size)
        after = _changed(before, code, plan[MODE], value, result)
        for k in range(size):
            data[at + k] = after >> (8 * k) & 0xFF
        changed |= after != before
        saturated += int(result[1])
        if np.isfinite(result[0]):
            step = max(step, result[0])
    if changed:
        hits[first, FRAMES_HIT] += 1
        hits[first, SATURATED] += saturated
        hits[first, LAST] = t_us
        steps[first] = max(steps[first], step)
    return changed


@njit(error_model="numpy", forceinline=True)
def _patch(at, head, size, entry, sender, from_vehicle, t_us, wire):
    """Apply the planned faults of a frame's message, one after the other; whether it changed."""
    data, plans, tables = wire[0], wire[3], wire[10]
    changed = False
    first = entry[PLAN]
    while first >= 0:
        if _is_for(plans[first], sender, from_vehicle):
            changed |= _act(at + head, first, t_us, wire)
        first = plans[first, NEXT]
    if changed:
        tail = at + head + size
        crc = _crc(data, at + 1, tail, entry[EXTRA], tables)
        data[tail] = crc & 0xFF
        data[tail + 1] = crc >> 8
    return changed


@njit(error_model="numpy", forceinline=True)
def _is_for(plan, sender, from_vehicle):
    """Whether a planned fault's `where` lets the sender through."""
    return (
        (plan[SYSTEM] < 0 or plan[SYSTEM] == sender >> 8)
        and (plan[COMPONENT] < 0 or plan[COMPONENT] == sender & 0xFF)
        and (plan[DIRECTION] < 0 or plan[DIRECTION] == from_vehicle)
    )


@njit(error_model="numpy", forceinline=True)
def _log(log, place, turn, now_us, data, at, length):
    """Append one record to a log; `place` is the entry of `turn` that counts its bytes."""
    start = turn[place]
    for k in range(8):
        log[start + k] = now_us >> (56 - 8 * k) & 0xFF
    for k in range(length):
        log[start + 8 + k] = data[at + k]
    turn[place] = start + 8 + length


@njit(error_model="numpy", forceinline=True)
def take(start, length, link, mask, now_us, ports, turn, wire):
    """Count, patch and record the frames of one plain datagram."""
    data, memory, table = wire[0], wire[1], wire[2]
    received, sent, index = wire[4], wire[5], wire[6]
    from_vehicle = ports[link, FROM_VEHICLE]
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
        if from_vehicle:
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
        if entry[KIND] == PLANNED:
            changed = _patch(at, head, size, entry, sender, from_vehicle, t_us, wire)
            ports[link, FAULTED] += changed
        if turn[KEEP] and mask:
            _log(sent, SENT_AT, turn, now_us, data, at, whole)
        at += whole
