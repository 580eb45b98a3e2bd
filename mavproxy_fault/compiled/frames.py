"""The compiled form's frames: verified, timed, counted, changed, routed and recorded one by one.

`pass_chunk` takes the frames of a datagram (or of a chunk of a stream), and appends what leaves to
the outgoing segments. It stops at a frame that needs the interpreter, with everything as it was
before that frame. Importing this file imports numba.
"""

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.chains import apply_chain, is_ready, read_instance, seal
from mavproxy_fault.compiled.element_bytes import little_endian
from mavproxy_fault.compiled.kernel import i64, kernel, kernel_of
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.compiled.signatures import check_signature, note_signature
from mavproxy_fault.fault_parts.hits import FRAMES
from mavproxy_fault.proxy import sender_rules
from mavproxy_fault.proxy import senders as cells
from mavproxy_fault.proxy.sender_rules import MAX_STAMP_US, SAMPLE_PERIOD_US, UNIX_TIME_FROM_US
from mavproxy_fault.proxy.vehicle_clock import HIL_SENSOR
from mavproxy_fault.wire.frame import SIGNATURE_LENGTH
from mavproxy_fault.wire.framing import frame_header, has_valid_checksum

# The rules of the core, as machine code
vehicle_time = kernel_of(sender_rules.vehicle_time)
link_time = kernel_of(sender_rules.link_time)
missing_before = kernel_of(sender_rules.missing_before)
read_target = kernel_of(sender_rules.read_target)
select_links = kernel_of(sender_rules.select_links)


@kernel
def _stamp_us(payload: int, size: int, number: int, shared: Shared) -> int:
    """The stamp of a frame in microseconds, 0 without one; as `vehicle_clock.stamp_us`."""
    entry = shared.table[number]
    if entry[k.STAMP_AT] < 0:
        return i64(0)
    length = min(entry[k.STAMP_SIZE], size - entry[k.STAMP_AT])
    count = little_endian(shared.data, payload + entry[k.STAMP_AT], length)
    # Eight bytes may make a negative number, or one that is too large to be scaled.
    found = count * entry[k.STAMP_SCALE] if 0 <= count < MAX_STAMP_US else i64(0)
    return found if found < MAX_STAMP_US else i64(0)


@kernel
def _is_sampled(
    payload: int, size: int, number: int, sender: int, t_us: int, shared: Shared
) -> bool:
    """Whether this period of a sampled message already has a frame, which the core has seen."""
    instance = read_instance(payload, size, number, shared)
    key = i64(number) << 32 | sender << 16 | (instance & 0xFFFF)
    sample = shared.samples[(key ^ key >> 11 ^ key >> 32) % k.SAMPLES]
    period = t_us // SAMPLE_PERIOD_US
    if sample[0] == key and sample[1] == period:
        return True
    sample[0], sample[1] = key, period
    return False


@kernel
def _is_ready_at(
    payload: int, size: int, number: int, sender: int, link: int, now_us: int, signed: bool,
    shared: Shared,
) -> int:  # fmt: skip
    """The vehicle time of a frame; UNKNOWN, and no clock changed, if the core has to take it."""
    senders, kind = shared.senders, shared.table[number, k.KIND]
    stamp_us = _stamp_us(payload, size, number, shared)
    simulator_begins = number == HIL_SENSOR and senders[cells.SIMULATED] == 0
    if stamp_us and (simulator_begins or senders[cells.T0] == cells.UNKNOWN):
        return i64(cells.UNKNOWN)
    clock = sender << 1 | (1 if stamp_us >= UNIX_TIME_FROM_US else 0)
    system = cells.SYSTEM_TIME + (sender >> 8)
    before = (
        senders[cells.CLOCK_OFFSET + clock], senders[cells.NEWEST_STAMP + clock],
        senders[cells.LAST_HEARD + clock], senders[cells.CANDIDATE_STAMP + clock],
        senders[system], senders[cells.NEWEST_TIME], senders[cells.UNCONFIRMED],
        senders[cells.LINK_TIME], senders[cells.LINK_STAMP], senders[cells.LINK_STAMP_HEARD],
        senders[cells.LINK_CLOCK],
    )  # fmt: skip
    t_us = vehicle_time(senders, sender, stamp_us, now_us)
    senders[cells.LINK_TIME] = link_time(senders, now_us)
    ready = senders[cells.UNCONFIRMED] == before[6]
    if shared.table[number, k.SAMPLED] and not _is_sampled(
        payload, size, number, sender, t_us, shared
    ):
        ready = False
    if kind != k.PASS and (
        t_us >= shared.loop[k.EDGE] or senders[cells.LINK_TIME] >= shared.loop[k.LINK_EDGE]
    ):
        ready = False
    if ready and kind == k.PLANNED:
        ready = is_ready(payload, size, number, sender, link, t_us, signed, shared)
    if ready:
        return i64(t_us)
    (
        senders[cells.CLOCK_OFFSET + clock], senders[cells.NEWEST_STAMP + clock],
        senders[cells.LAST_HEARD + clock], senders[cells.CANDIDATE_STAMP + clock],
        senders[system], senders[cells.NEWEST_TIME], senders[cells.UNCONFIRMED],
        senders[cells.LINK_TIME], senders[cells.LINK_STAMP], senders[cells.LINK_STAMP_HEARD],
        senders[cells.LINK_CLOCK],
    ) = before  # fmt: skip
    return i64(cells.UNKNOWN)


@kernel
def _record(
    log: k.Octets, place: int, now_us: int, source: k.Octets, at: int, length: int, shared: Shared
) -> None:
    """Append a frame to a log; `place` is the entry of `loop` that counts the log's bytes."""
    start = shared.loop[place]
    for n in range(8):
        log[start + n] = now_us >> (56 - 8 * n) & 0xFF
    for n in range(length):
        log[start + 8 + n] = source[at + n]
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
    _record(shared.received, k.RECEIVED_AT, now_us, shared.data, at, length, shared)


@kernel
def _send(source: k.Octets, at: int, length: int, mask: int, now_us: int, shared: Shared) -> None:
    """Append a frame to the outgoing segment for its links, and record it."""
    loop, segments, segment = shared.loop, shared.segments, shared.loop[k.SEGMENT] - 1
    if (
        segment < 0
        or segments[segment, k.LINKS] != mask
        or segments[segment, k.BYTES_OUT] + length > k.LONGEST
    ):
        segment += 1
        loop[k.SEGMENT] = segment + 1
        segments[segment, k.LINKS], segments[segment, k.BYTES_OUT] = mask, 0
    out = loop[k.OUT_AT]
    for n in range(length):
        shared.outs[out + n] = source[at + n]
    loop[k.OUT_AT] += length
    segments[segment, k.BYTES_OUT] += length
    if loop[k.KEEP]:
        _record(shared.sent, k.SENT_AT, now_us, source, at, length, shared)


@kernel
def _hold(item: int, mask: int, now_us: int, shared: Shared) -> None:
    """Keep a delayed frame, and let the stretch of forwarding end when it is due."""
    loop, held, start = shared.loop, shared.held, shared.loop[k.HELD_AT]
    due_us = now_us + shared.items[item, k.LATE_US]
    length = shared.items[item, k.LENGTH_OF]
    for n in range(8):
        held[start + n] = due_us >> (8 * n) & 0xFF
        held[start + 8 + n] = mask >> (8 * n) & 0xFF
        held[start + 16 + n] = length >> (8 * n) & 0xFF
    for n in range(length):
        held[start + k.HELD_HEAD + n] = shared.work[item * k.SLOT + n]
    loop[k.HELD_AT] = start + k.HELD_HEAD + length
    due_ns = (due_us - k.AHEAD_US) * 1000 - loop[k.BASE]
    if due_ns < loop[k.DEADLINE]:
        loop[k.DEADLINE], loop[k.PRECISE] = due_ns, 1


@kernel
def _is_full(shared: Shared) -> bool:
    """Whether there may be no room for what one frame becomes."""
    loop, most = shared.loop, k.MOST_WORK * (k.SLOT + k.HELD_HEAD)
    return bool(
        loop[k.SEGMENT] > k.SEGMENTS - 2
        or loop[k.OUT_AT] + most > k.OUT_SIZE
        or loop[k.HELD_AT] + most > k.HELD_SIZE
        or (loop[k.KEEP] and max(loop[k.RECEIVED_AT], loop[k.SENT_AT]) + most > k.LOG_SIZE)
    )


@kernel
def _pass_frame(
    at: int, head: int, number: int, stop: int, link: int, now_us: int, shared: Shared
) -> int:
    """Pass a frame; DONE or NEWS, FRAME or REST if the core has to take it."""
    loop, data, senders, ports = shared.loop, shared.data, shared.senders, shared.ports
    size, payload, bit = i64(data[at + 1]), at + head, i64(1) << link
    place = at + (5 if head == 10 else 3)
    sender = i64(data[place]) << 8 | i64(data[place + 1])
    if number >= k.IDS:
        return k.REST
    entry = shared.table[number]
    if not has_valid_checksum(data.ctypes.data, at, head, np.uint64(entry[k.EXTRA]), shared.crc):
        return k.REST
    unknown = senders[cells.LINKS + sender] != bit
    if unknown or entry[k.KIND] == k.INTERPRETED:
        return k.FRAME
    elsewhere = ((i64(1) << loop[k.LINK_COUNT]) - 1) & ~bit
    places = (entry[k.TARGET_SYSTEM], entry[k.TARGET_COMPONENT])
    mask = select_links(senders, i64(read_target(data, payload, size, places)), elsewhere)
    loop[k.OTHERS] |= mask & ~loop[k.COMPILED_LINKS]
    sealed, cell = check_signature(at, head, stop, shared)
    t_us = _is_ready_at(payload, size, number, sender, link, now_us, sealed, shared)
    if t_us == cells.UNKNOWN:
        return k.FRAME
    ports[link, k.FRAMES] += 1
    seq = i64(data[at + (4 if head == 10 else 2)])
    ports[link, k.MISSING] += missing_before(senders, sender, seq)
    if ports[link, k.FROM_VEHICLE]:
        senders[cells.VEHICLE_SYSTEM] = sender >> 8
    senders[cells.WALL_OFFSET] = now_us - senders[cells.LINK_TIME]
    if loop[k.KEEP]:
        _record_received(link, now_us, at, stop - at, shared)
    stop = note_signature(at, stop, entry[k.EXTRA], sealed, cell, link, shared)
    signature_at = stop - SIGNATURE_LENGTH if head == 10 and data[at + 2] else 0
    if entry[k.KIND] != k.PASS:
        loop[k.WANTED_AT], loop[k.WANTED_LINK_AT] = t_us, senders[cells.LINK_TIME]
    if entry[k.KIND] != k.PLANNED:
        if mask:
            _send(data, at, stop - at, mask, now_us, shared)
        return k.DONE
    count, changed = apply_chain(at, head, stop - at, number, link, t_us, shared)
    left, same = 0, True
    for item in range(count):
        if shared.items[item, k.LENGTH_OF] == 0:
            continue
        left += 1
        same &= shared.items[item, k.ALTERED] != k.CHANGED and shared.items[item, k.LATE_US] == 0
        if mask == 0:
            continue
        if shared.items[item, k.ALTERED]:
            seal(item, head, entry[k.EXTRA], signature_at, shared)
        if shared.items[item, k.LATE_US]:
            _hold(item, mask, now_us, shared)
        else:
            length = shared.items[item, k.LENGTH_OF]
            _send(shared.work, item * k.SLOT, length, mask, now_us, shared)
    ports[link, k.FAULTED] += left != 1 or not same
    return k.NEWS if changed and _has_news(number, shared) else k.DONE


@kernel
def _has_news(number: int, shared: Shared) -> bool:
    """Whether an entry of a message has acted whose label has not begun."""
    first = shared.table[number, k.CHAIN]
    while first >= 0:
        entry = shared.entries[shared.steps[first, k.ENTRY]]
        if not entry[k.ANNOUNCED] and shared.memory[entry[k.COUNTS_AT] + FRAMES]:
            return True
        first = shared.steps[first, k.NEXT]
    return False


@kernel
def begin_chunk(length: int, loop: k.Integers) -> None:
    """Begin with a chunk of so many bytes in `data`, of which nothing leaves yet."""
    loop[k.LENGTH], loop[k.ROW_AT], loop[k.FOUND] = length, 0, k.REST
    loop[k.OUT_AT] = loop[k.SEGMENT] = loop[k.OTHERS] = 0


@kernel
def pass_chunk(shared: Shared) -> None:
    """Pass the frames of a chunk; FOUND is what became of it, ROW_AT where its rest begins."""
    loop, found = shared.loop, k.DONE
    now_us = (loop[k.BASE] + loop[k.CAME]) // 1000
    while found == k.DONE and loop[k.ROW_AT] < loop[k.LENGTH]:
        at = loop[k.ROW_AT]
        head, number, stop = frame_header(shared.data.ctypes.data, loop[k.LENGTH], at)
        found = k.FULL if _is_full(shared) else k.REST
        if found == k.REST and head:
            found = _pass_frame(at, head, number, stop, loop[k.LINK], now_us, shared)
            if found == k.DONE or found == k.NEWS:
                loop[k.ROW_AT] = stop
    loop[k.FOUND] = found
