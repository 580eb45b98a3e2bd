"""The compiled form's frames: verified, timed, counted, changed, routed and recorded one by one.

`pass_chunk` takes the frames of a datagram (or of a chunk of a stream), and appends what leaves to
the outgoing segments. It stops at a frame that needs the interpreter, of which only the time is
noted. Importing this file imports numba.
"""

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.chains import apply_chain, is_ready, read_instance, seal
from mavproxy_fault.compiled.element_bytes import copy_bytes
from mavproxy_fault.compiled.kernel import i64, kernel, kernel_of
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.compiled.signatures import check_signature, note_signature
from mavproxy_fault.proxy import delay_queue, sender_rules
from mavproxy_fault.proxy import senders as cells
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.proxy.sender_rules import SAMPLE_PERIOD_US
from mavproxy_fault.proxy.vehicle_clock import HIL_SENSOR
from mavproxy_fault.wire import frame
from mavproxy_fault.wire.frame import SIGNATURE_LENGTH
from mavproxy_fault.wire.framing import has_valid_checksum

SPREAD = 0x9E3779B97F4A7  # 2^52 by the golden ratio: close keys get distant places (Knuth 6.4)

# The rules of the core, as machine code
whole_frame = kernel_of(frame.whole_frame)
has_unknown_flags = kernel_of(frame.has_unknown_flags)
vehicle_time = kernel_of(sender_rules.vehicle_time)
link_time = kernel_of(sender_rules.link_time)
missing_before = kernel_of(sender_rules.missing_before)
put = kernel_of(delay_queue.put)
take = kernel_of(delay_queue.take)
follow_simulator = kernel_of(delay_queue.follow_simulator)
read_stamp = kernel_of(sender_rules.read_stamp)
read_target = kernel_of(sender_rules.read_target)
select_links = kernel_of(sender_rules.select_links)


@kernel
def _is_ready_at(
    payload: int, size: int, number: int, sender: int, link: int, now_us: int, signed: bool,
    shared: Shared,
) -> bool:  # fmt: skip
    """Whether a frame can pass here; TIMED is its vehicle time then, also for the core, or UNKNOWN
    where that has to begin the timeline."""
    senders, loop, table = shared.senders, shared.loop, shared.table[number]
    place = (table[k.STAMP_AT], table[k.STAMP_SIZE], table[k.STAMP_SCALE])
    stamp_us = i64(read_stamp(shared.data, payload, size, place))
    simulator_begins = number == HIL_SENSOR and senders[cells.SIMULATED] == 0
    if stamp_us and (simulator_begins or senders[cells.T0] == cells.UNKNOWN):
        return False
    unconfirmed = senders[cells.UNCONFIRMED]
    t_us = loop[k.TIMED] = vehicle_time(senders, sender, stamp_us, now_us)
    senders[cells.LINK_TIME] = link_time(senders, now_us)
    at_edge = t_us >= loop[k.EDGE] or senders[cells.LINK_TIME] >= loop[k.LINK_EDGE]
    if senders[cells.UNCONFIRMED] != unconfirmed or (table[k.KIND] != k.PASS and at_edge):
        return False
    return bool(
        table[k.KIND] != k.PLANNED
        or is_ready(payload, size, number, sender, link, t_us, signed, shared)
    )


@kernel
def _record(
    log: k.Octets, place: int, now_us: int, source: k.Octets, at: int, length: int, shared: Shared
) -> None:
    """Append a frame to a log; `place` is the entry of `loop` that counts the log's bytes."""
    start = shared.loop[place]
    for n in range(8):
        log[start + n] = now_us >> (56 - 8 * n) & 0xFF
    copy_bytes(source, at, length, log, start + 8)
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
def _sample(
    source: k.Octets, at: int, head: int, number: int, length: int, t_us: int, sides: int,
    shared: Shared,
) -> None:  # fmt: skip
    """Keep a frame for viewers, the first of each period; it was received (1), sent (2) or both."""
    place = at + (5 if head == 10 else 3)
    sender = i64(source[place]) << 8 | i64(source[place + 1])
    instance = read_instance(source.ctypes.data + at + head, i64(source[at + 1]), number, shared)
    key = i64(number) << 34 | sender << 18 | (instance & 0xFFFF) << 2 | sides
    sample = shared.samples[(key * SPREAD >> 40) % k.SAMPLES]
    period = t_us // SAMPLE_PERIOD_US
    is_full = shared.loop[k.SAMPLES_AT] + k.SLOT + 16 > k.SAMPLED_SIZE
    if is_full or (sample[0] == key and sample[1] == period):
        return
    sample[0], sample[1] = key, period
    _record(shared.sampled, k.SAMPLES_AT, t_us << 2 | sides, source, at, length, shared)


@kernel
def _sample_sent(source: k.Octets, at: int, length: int, t_us: int, shared: Shared) -> None:
    """Keep what is sent for viewers, if it is still a frame."""
    head, number, stop = whole_frame(source, at, at + length)
    if stop == at + length and number < k.IDS and shared.table[number, k.SAMPLED]:
        _sample(source, at, head, number, length, t_us, 2, shared)


@kernel
def _send(source: k.Octets, at: int, length: int, mask: int, now_us: int, shared: Shared) -> None:
    """Append a frame to the outgoing segment for its links, and record it."""
    loop, segments, segment = shared.loop, shared.segments, shared.loop[k.SEGMENT] - 1
    if (
        segment < 0
        or segments[segment, k.LINKS] != mask
        or segments[segment, k.BYTES_OUT] + length > k.LONGEST
    ):
        segment = _begin_segment(mask, now_us, shared)
    copy_bytes(source, at, length, shared.outs, loop[k.OUT_AT])
    loop[k.OUT_AT] += length
    segments[segment, k.BYTES_OUT] += length
    if not loop[k.KEEP]:
        return
    if whole_frame(source, at, at + length)[2] == at + length:
        _record(shared.sent, k.SENT_AT, now_us, source, at, length, shared)
        return
    place = loop[k.OTHER_AT]  # cut: its length, before the record
    shared.other[place], shared.other[place + 1] = length >> 8, length & 0xFF
    loop[k.OTHER_AT] = place + 2
    _record(shared.other, k.OTHER_AT, now_us, source, at, length, shared)


@kernel
def _begin_segment(mask: int, due_us: int, shared: Shared) -> int:
    """Begin another outgoing segment."""
    segment = shared.loop[k.SEGMENT]
    shared.loop[k.SEGMENT] = segment + 1
    shared.segments[segment, k.LINKS], shared.segments[segment, k.BYTES_OUT] = mask, 0
    shared.segments[segment, k.DUE_US] = due_us
    return i64(segment)


@kernel
def _hold(item: int, mask: int, now_us: int, shared: Shared) -> None:
    """Keep a delayed frame until it is due, if there is room."""
    length, shared.loop[k.HELD] = shared.items[item, k.LENGTH_OF], 1
    place = put(shared.waiting, now_us + shared.items[item, k.LATE_US], mask, length)
    if place >= 0:
        copy_bytes(shared.work, item * k.SLOT, length, shared.delayed, place * k.SLOT)


@kernel
def first_due_us(shared: Shared) -> int:
    """When the first delayed frame is due."""
    queue = shared.waiting
    row = delay_queue.ROWS + delay_queue.ROW * queue[delay_queue.HEAP]
    return i64(queue[row + delay_queue.DUE] if queue[delay_queue.COUNT] else NEVER_US)


@kernel
def release_due(now_us: int, shared: Shared) -> bool:
    """Append the delayed frames that are due to the outgoing segments, up to one that the core has
    to release; False for none."""
    loop, queue = shared.loop, shared.waiting
    engine_us = loop[k.ENGINE_DUE] + shared.senders[cells.WALL_OFFSET]
    while not _is_full(shared):
        due_us, place = first_due_us(shared), queue[delay_queue.HEAP]
        row = delay_queue.ROWS + delay_queue.ROW * place
        mask, length = queue[row + delay_queue.LINKS], queue[row + delay_queue.LENGTH]
        if due_us > now_us or due_us > engine_us or length == delay_queue.OWN:
            break
        take(queue)
        when_us = queue[delay_queue.LAST_DUE] = max(due_us, queue[delay_queue.LAST_DUE])
        loop[k.OTHERS] |= mask & ~loop[k.COMPILED_LINKS]
        if mask & loop[k.SEPARATE]:
            _begin_segment(mask, when_us, shared)
        _send(shared.delayed, place * k.SLOT, length, mask, when_us, shared)
        t_us = when_us - shared.senders[cells.WALL_OFFSET]
        _sample_sent(shared.delayed, place * k.SLOT, length, t_us, shared)
    return bool(loop[k.SEGMENT] > 0)


@kernel
def _is_full(shared: Shared) -> bool:
    """Whether there may be no room for what one frame becomes."""
    loop, most = shared.loop, k.MOST_WORK * (k.SLOT + 8)  # with the stamps of a log
    return bool(
        loop[k.SEGMENT] > k.SEGMENTS - 2
        or loop[k.OUT_AT] + most > k.OUT_SIZE
        or (loop[k.KEEP] and max(loop[k.RECEIVED_AT], loop[k.SENT_AT]) + most > k.LOG_SIZE)
        or loop[k.OTHER_AT] + most > k.OTHER_SIZE
    )


@kernel
def _pass_frame(
    at: int, head: int, number: int, stop: int, link: int, now_us: int, shared: Shared
) -> int:
    """Pass a frame; DONE or NEWS, FRAME or REST if the core has to take it."""
    loop, data, senders, ports = shared.loop, shared.data, shared.senders, shared.ports
    loop[k.TIMED] = cells.UNKNOWN
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
    if loop[k.SIGNING] & k.KEYED and not loop[k.SHA_INIT] and head == 10 and data[at + 2]:
        return k.FRAME
    sealed, cell = check_signature(at, head, stop, shared)
    if not _is_ready_at(payload, size, number, sender, link, now_us, sealed, shared):
        return k.FRAME
    t_us = loop[k.TIMED]
    ports[link, k.FRAMES] += 1
    seq = i64(data[at + (4 if head == 10 else 2)])
    ports[link, k.MISSING] += missing_before(senders, sender, seq)
    if ports[link, k.FROM_VEHICLE]:
        senders[cells.VEHICLE_SYSTEM] = sender >> 8
    senders[cells.WALL_OFFSET] = now_us - senders[cells.LINK_TIME]
    if number == HIL_SENSOR:
        follow_simulator(shared.waiting, t_us, now_us)
    if entry[k.SAMPLED]:
        sides = 3 if mask and entry[k.KIND] != k.PLANNED else 1
        _sample(data, at, head, number, stop - at, t_us, sides, shared)
    if loop[k.KEEP]:
        _record_received(link, now_us, at, stop - at, shared)
    stop = note_signature(at, stop, entry[k.EXTRA], sealed, cell, link, shared)
    if entry[k.KIND] != k.PASS:
        loop[k.WANTED_AT], loop[k.WANTED_LINK_AT] = t_us, senders[cells.LINK_TIME]
    if entry[k.KIND] != k.PLANNED:
        if mask:
            _send(data, at, stop - at, mask, now_us, shared)
        return k.DONE
    loop[k.NEW_LABEL], loop[k.CRC_EXTRA] = 0, entry[k.EXTRA]
    loop[k.SIGNATURE_AT] = stop - SIGNATURE_LENGTH if head == 10 and data[at + 2] else 0
    count = apply_chain(at, head, stop - at, number, link, t_us, shared)
    ports[link, k.FAULTED] += _send_items(count, head, mask, now_us, shared)
    return k.NEWS if loop[k.NEW_LABEL] else k.DONE


@kernel
def _send_items(count: int, head: int, mask: int, now_us: int, shared: Shared) -> bool:
    """Send or delay the frames that one has become; whether that is not itself, at once."""
    items, left, same = shared.items, 0, True
    for item in range(count):
        length, late_us = items[item, k.LENGTH_OF], items[item, k.LATE_US]
        if length == 0:
            continue
        left += 1
        same &= items[item, k.ALTERED] < k.CHANGED and late_us == 0
        if mask == 0:
            continue
        if k.RESEALED <= items[item, k.ALTERED] <= k.CHANGED:
            seal(item, head, shared)
        if late_us:
            _hold(item, mask, now_us, shared)
        else:
            _send(shared.work, item * k.SLOT, length, mask, now_us, shared)
            _sample_sent(shared.work, item * k.SLOT, length, shared.loop[k.TIMED], shared)
    return bool(left != 1 or not same)


@kernel
def begin_sending(loop: k.Integers) -> None:
    """Begin with no outgoing segments."""
    loop[k.OUT_AT] = loop[k.SEGMENT] = loop[k.OTHERS] = loop[k.HELD] = 0


@kernel
def begin_chunk(length: int, loop: k.Integers) -> None:
    """Begin with a chunk of so many bytes in `data`, of which nothing leaves yet."""
    loop[k.LENGTH], loop[k.ROW_AT], loop[k.FOUND] = length, 0, k.REST
    begin_sending(loop)


@kernel
def pass_chunk(shared: Shared) -> None:
    """Pass the frames of a chunk; FOUND is what became of it, ROW_AT where its rest begins."""
    loop, found = shared.loop, k.DONE
    now_us = (loop[k.BASE] + loop[k.CAME]) // 1000
    while found == k.DONE and loop[k.ROW_AT] < loop[k.LENGTH]:
        at = loop[k.ROW_AT]
        head, number, stop = whole_frame(shared.data, at, loop[k.LENGTH])
        found = k.FULL if _is_full(shared) else k.REST
        if found == k.REST and head and not has_unknown_flags(shared.data, at):
            found = _pass_frame(at, head, number, stop, loop[k.LINK], now_us, shared)
            if found == k.DONE or found == k.NEWS:
                loop[k.ROW_AT] = stop
    loop[k.FOUND] = found
