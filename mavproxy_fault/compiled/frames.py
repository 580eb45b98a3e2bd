"""The compiled form's frames: whole datagrams verified, timed, counted and recorded.

`links_of` decides, `step` carries out. A datagram goes this way only if all of it can: known
senders on UDP links, whole frames with right CRCs and no signature, messages that no fault acts on
or only those that `plans` can write down. Anything else is handed over to the interpreted way, with
the array of senders as it was before, so that order and state stay exact. Importing this file
imports numba.
"""

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.kernel import i64, kernel
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.compiled.patches import draws_for, little, patch
from mavproxy_fault.proxy import sender_rules
from mavproxy_fault.proxy import senders as cells
from mavproxy_fault.proxy.sender_rules import MAX_STAMP_US, UNIX_TIME_FROM_US
from mavproxy_fault.proxy.vehicle_clock import HIL_SENSOR
from mavproxy_fault.wire.framing import frame_header, has_valid_checksum

# The rules of the interpreted way, as machine code
vehicle_time = kernel(sender_rules.vehicle_time)
missing_before = kernel(sender_rules.missing_before)
addressee = kernel(sender_rules.read_target)
links_towards = kernel(sender_rules.select_links)


@kernel
def sender_of(at: int, head: int, shared: Shared) -> int:
    """`system << 8 | component` of a frame whose header has `head` bytes."""
    place = at + (5 if head == 10 else 3)
    return i64(shared.data[place]) << 8 | i64(shared.data[place + 1])


@kernel
def stamp(payload: int, size: int, number: int, shared: Shared) -> int:
    """The stamp of a frame in microseconds, 0 without one; as `vehicle_clock.stamp_us`."""
    entry = shared.table[number]
    if entry[k.STAMP_AT] < 0:
        return i64(0)
    length = min(entry[k.STAMP_SIZE], size - entry[k.STAMP_AT])
    count = little(shared.data, payload + entry[k.STAMP_AT], length)
    # Eight bytes may make a negative number, or one that is too large to be scaled.
    found = count * entry[k.STAMP_SCALE] if 0 <= count < MAX_STAMP_US else i64(0)
    return found if found < MAX_STAMP_US else i64(0)


@kernel
def _note(place: int, shared: Shared) -> None:
    """Save the value of an entry of `senders` before it is changed."""
    loop = shared.loop
    row = shared.undo[loop[k.UNDO_COUNT]]
    row[k.UNDO_PLACE], row[k.UNDO_VALUE] = place, shared.senders[place]
    loop[k.UNDO_COUNT] += 1


@kernel
def _time(sender: int, number: int, stamp_us: int, now_us: int, shared: Shared) -> int:
    """Vehicle time of a frame; UNKNOWN where the interpreted way has something to say about it."""
    senders = shared.senders
    if stamp_us:
        simulator_begins = number == HIL_SENSOR and senders[cells.SIMULATED] == 0
        if simulator_begins or senders[cells.T0] == cells.UNKNOWN:
            return i64(cells.UNKNOWN)
        clock = sender << 1 | (1 if stamp_us >= UNIX_TIME_FROM_US else 0)
        _note(cells.CLOCK_OFFSET + clock, shared)
        _note(cells.NEWEST_STAMP + clock, shared)
        _note(cells.LAST_HEARD + clock, shared)
        _note(cells.CANDIDATE_STAMP + clock, shared)
        _note(cells.SYSTEM_TIME + (sender >> 8), shared)
        _note(i64(cells.NEWEST_TIME), shared)
        _note(i64(cells.UNCONFIRMED), shared)
    doubted = senders[cells.UNCONFIRMED]
    t_us = vehicle_time(senders, sender, stamp_us, now_us)
    return t_us if senders[cells.UNCONFIRMED] == doubted else i64(cells.UNKNOWN)


@kernel
def _links_of_frame(at: int, head: int, number: int, link: int, now_us: int, shared: Shared) -> int:
    """The links one frame goes to, -1 if it is to be handed over; its time is noted."""
    loop, data, senders = shared.loop, shared.data, shared.senders
    size, payload = i64(data[at + 1]), at + head
    bit = i64(1) << link
    sender = sender_of(at, head, shared)
    signed_or_odd = head == 10 and data[at + 2] != 0
    if signed_or_odd or number >= k.IDS or senders[cells.LINKS + sender] != bit:
        return -1
    entry = shared.table[number]
    if entry[k.KIND] == k.INTERPRETED or loop[k.FRAME_COUNT] == k.MOST_FRAMES:
        return -1
    if not has_valid_checksum(data.ctypes.data, at, head, np.uint64(entry[k.EXTRA]), shared.crc):
        return -1
    t_us = _time(sender, number, stamp(payload, size, number, shared), now_us, shared)
    if t_us == cells.UNKNOWN or (entry[k.KIND] != k.PASS and t_us >= loop[k.EDGE]):
        return -1
    if entry[k.KIND] == k.PLANNED:
        drawn = draws_for(payload, size, entry[k.PLAN], sender, link, t_us, shared)
        if drawn < 0:
            return -1
        loop[k.DRAWS] += drawn
    shared.times[loop[k.FRAME_COUNT]] = t_us
    loop[k.FRAME_COUNT] += 1
    elsewhere = ((i64(1) << loop[k.LINK_COUNT]) - 1) & ~bit
    places = (entry[k.TARGET_SYSTEM], entry[k.TARGET_COMPONENT])
    found = links_towards(senders, i64(addressee(data, payload, size, places)), elsewhere)
    return -1 if found & ~loop[k.COMPILED_LINKS] else found


@kernel
def links_of(start: int, length: int, link: int, now_us: int, shared: Shared) -> int:
    """The links a datagram goes to, -1 if it is to be handed over.

    Each frame advances its sender's clock, so that the next frame is judged by the updated time;
    if the datagram is handed over, these changes are undone.
    """
    loop, undo = shared.loop, shared.undo
    loop[k.FRAME_COUNT] = loop[k.DRAWS] = loop[k.UNDO_COUNT] = 0
    at, end = start, start + length
    mask = i64(-1)
    while at < end:
        head, number, stop = frame_header(shared.data.ctypes.data, end, at)
        found = i64(-1)
        if head:
            found = _links_of_frame(at, head, number, link, now_us, shared)
        if found < 0 or (mask >= 0 and found != mask):
            for n in range(loop[k.UNDO_COUNT] - 1, -1, -1):
                shared.senders[undo[n, k.UNDO_PLACE]] = undo[n, k.UNDO_VALUE]
            return -1
        mask, at = found, stop
    return mask


@kernel
def _record(log: k.Octets, place: int, now_us: int, at: int, length: int, shared: Shared) -> None:
    """Append a frame to a log; `place` is the entry of `loop` that counts the log's bytes."""
    start = shared.loop[place]
    for n in range(8):
        log[start + n] = now_us >> (56 - 8 * n) & 0xFF
    for n in range(length):
        log[start + 8 + n] = shared.data[at + n]
    shared.loop[place] = start + 8 + length


@kernel
def _record_received(link: int, now_us: int, at: int, length: int, shared: Shared) -> None:
    """Note a frame as `CaptureBuffer.receive` does."""
    place = shared.loop[k.INDEX_AT]
    shared.index[place] = link
    shared.index[place + 1] = 0
    for n in range(4):
        shared.index[place + 2 + n] = length >> (8 * n) & 0xFF
    shared.loop[k.INDEX_AT] = place + 6
    _record(shared.received, k.RECEIVED_AT, now_us, at, length, shared)


@kernel
def step(start: int, length: int, link: int, mask: int, now_us: int, shared: Shared) -> None:
    """Count, patch and record the frames of a datagram whose links were found."""
    loop, data, senders, ports = shared.loop, shared.data, shared.senders, shared.ports
    at, frame = start, 0
    while at < start + length:
        head, number, stop = frame_header(data.ctypes.data, start + length, at)
        sender, size = sender_of(at, head, shared), i64(data[at + 1])
        entry, t_us = shared.table[number], shared.times[frame]
        ports[link, k.FRAMES] += 1
        seq = i64(data[at + (4 if head == 10 else 2)])
        ports[link, k.MISSING] += missing_before(senders, sender, seq)
        if ports[link, k.FROM_VEHICLE]:
            senders[cells.VEHICLE_SYSTEM] = sender >> 8
        senders[cells.WALL_OFFSET] = now_us - t_us
        if loop[k.KEEP]:
            _record_received(link, now_us, at, stop - at, shared)
        if entry[k.KIND] != k.PASS:
            loop[k.WANTED_AT] = t_us
        if entry[k.KIND] == k.PLANNED:
            ports[link, k.FAULTED] += patch(at, head, size, number, link, t_us, shared)
        if loop[k.KEEP] and mask:
            _record(shared.sent, k.SENT_AT, now_us, at, stop - at, shared)
        at = stop
        frame += 1
