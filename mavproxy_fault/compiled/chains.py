"""The compiled form's faults: the chain of entries that act on a message.

`is_ready` looks whether all of them can act here on a frame; `apply_chain` lets them act, in turn,
on the frames that it becomes, which lie in `work`. The rules are those of `fault_parts.rules`.
"""

from typing import Any

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.element_bytes import (
    LARGEST_WHOLE,
    copy_bytes,
    larger_change,
    little_endian,
    read_element,
    sent_length,
    write_element,
)
from mavproxy_fault.compiled.kernel import choose, draw, i64, kernel, kernel_of
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.compiled.signatures import sign_again
from mavproxy_fault.fault_parts import hits
from mavproxy_fault.fault_parts.rules import LINK_RULES, LOST, VALUE_RULES
from mavproxy_fault.faults import bit_faults, frame_corruption
from mavproxy_fault.faults.registry import numbered_rules
from mavproxy_fault.proxy import sender_rules
from mavproxy_fault.proxy.senders import LINK_TIME
from mavproxy_fault.wire.framing import range_crc

SKIPPED, SIGNED = -1, -2  # places of entries that do not act on a frame, as it is signed

is_selected = kernel_of(sender_rules.is_selected)
note_hits = kernel_of(hits.note_hits)
count_flips = kernel_of(bit_faults.count_flips)
flip_bits = kernel_of(bit_faults.flip_bits)
mix_bytes = kernel_of(frame_corruption.mix_bytes)
_value_rule = choose(numbered_rules(VALUE_RULES), "x, i, t_s, p, m, u")
_link_rule = choose(numbered_rules(LINK_RULES), "t_us, size, p, m, u, v")


@kernel
def _find_memory(
    number: int, message: int, sender: int, from_vehicle: int, instance: int, shared: Shared
) -> int:
    """Where an entry's memory of a sender begins, -1 if it has none yet."""
    keys, by_sender = shared.keys, shared.entries[number, k.BY_SENDER]
    for n in range(shared.loop[k.KEY_COUNT]):
        key = keys[n]
        if key[k.KEY_ENTRY] != number or key[k.KEY_WAY] != from_vehicle:
            continue
        if not by_sender or (
            key[k.KEY_SENDER] == sender
            and key[k.KEY_MESSAGE] == message
            and key[k.KEY_INSTANCE] == instance
        ):
            return int(key[k.MEMORY_AT])
    return -1


@kernel
def _has_exact_numbers(payload: int, size: int, step: Any, shared: Shared) -> bool:
    """Whether 64-bit integers of a chain's elements are exact as numbers."""
    for row in range(step[k.FROM], step[k.TO]):
        element, at = shared.elements[row], shared.elements[row, k.OFFSET]
        if element[k.BYTES_OF] == 8 and element[k.KIND_OF] != k.REAL and at + 8 <= size:
            word = little_endian(shared.data.ctypes.data + payload + at, 8)
            if not 0 <= word < LARGEST_WHOLE:
                return False
    return True


@kernel
def read_instance(place: int, size: int, number: int, shared: Shared) -> int:
    """The instance of a message that distinguishes sensors of one kind, else 0.

    `place` is the address of its payload of `size` bytes.
    """
    table = shared.table[number]
    if table[k.INSTANCE_AT] < 0:
        return i64(0)
    length = min(table[k.INSTANCE_SIZE], size - table[k.INSTANCE_AT])
    return i64(little_endian(place + table[k.INSTANCE_AT], length))


@kernel
def _own_time(entry: Any, t_us: int, shared: Shared) -> int:
    """The time of an entry's clock at a frame of the vehicle time `t_us`."""
    return i64(shared.senders[LINK_TIME]) if entry[k.ON_LINK] else t_us


@kernel
def is_ready(
    payload: int, size: int, number: int, sender: int, link: int, t_us: int, signed: bool,
    shared: Shared,
) -> bool:  # fmt: skip
    """Whether all entries of a message can act on a frame here; `places` then says where."""
    table = shared.table[number]
    from_vehicle = shared.ports[link, k.FROM_VEHICLE]
    instance = read_instance(shared.data.ctypes.data + payload, size, number, shared)
    first, place = table[k.CHAIN], 0
    while first >= 0:
        step = shared.steps[first]
        entry = shared.entries[step[k.ENTRY]]
        shared.places[place] = SKIPPED
        where = (entry[k.SYSTEM], entry[k.COMPONENT], entry[k.DIRECTION], entry[k.INSTANCE])
        if is_selected(where, sender, from_vehicle, instance):
            if _own_time(entry, t_us, shared) >= entry[k.LABEL_AT]:
                return False
            shared.places[place] = 0
            if signed and not entry[k.SEALED_TOO]:
                shared.places[place] = SIGNED
            elif _own_time(entry, t_us, shared) >= entry[k.UNTIL]:
                return False
            elif entry[k.EFFECT] == k.IDLE:
                shared.places[place] = SKIPPED
            elif entry[k.REMEMBERS]:
                found = _find_memory(step[k.ENTRY], number, sender, from_vehicle, instance, shared)
                if found < 0:
                    return False
                shared.places[place] = found
            if not _has_exact_numbers(payload, size, step, shared):
                return False
        first = step[k.NEXT]
        place += 1
    return True


@kernel
def _draw(entry: Any) -> float:
    """An entry's next drawn number, 0 if it draws none."""
    return float(draw(entry[k.DRAW], entry[k.DRAWS_FROM])) if entry[k.DRAW] >= 0 else 0.0


@kernel
def _note_hit(
    entry: Any, t_us: int, link: int, saturated: int, largest: float, shared: Shared
) -> None:
    """Count a changed frame for an entry, and whether its label begins."""
    counts = shared.memory[entry[k.COUNTS_AT] :]
    shared.loop[k.NEW_LABEL] |= 1 - entry[k.ANNOUNCED]
    note_hits(counts, t_us, shared.ports[link, k.FROM_VEHICLE], 1, saturated, largest)


@kernel
def _act_on_values(
    item: int, head: int, step: Any, place: int, t_us: int, link: int, shared: Shared
) -> None:
    """Apply an entry to the values of a frame in `work`."""
    work, elements, entry = shared.work, shared.elements, shared.entries[step[k.ENTRY]]
    base = item * k.SLOT
    payload, size, first = base + head, i64(work[base + 1]), step[k.FROM]
    address = work.ctypes.data + payload
    if step[k.END] > size:  # truncated zeros, in place of the checksum
        for n in range(size, step[k.END]):
            work[payload + n] = 0
        shared.items[item, k.ALTERED] = max(shared.items[item, k.ALTERED], k.RESEALED)
    t_s = (t_us - entry[k.START]) / 1e6
    for row in range(first, step[k.TO]):
        bytes_of, kind = elements[row, k.BYTES_OF], elements[row, k.KIND_OF]
        healthy = read_element(address + elements[row, k.OFFSET], bytes_of, kind)
        factor = shared.factors[row, k.FACTOR]
        shared.values[row - first] = healthy if factor == 1.0 else healthy / factor
    changed, saturated, largest = False, 0, -1.0
    for row in range(first, step[k.TO]):
        at, i = address + elements[row, k.OFFSET], row - first
        bytes_of, kind = elements[row, k.BYTES_OF], elements[row, k.KIND_OF]
        p, scale = shared.numbers[elements[row, k.NUMBERS_AT] :], shared.factors[row, k.STEP_SCALE]
        before, healthy = little_endian(at, bytes_of), read_element(at, bytes_of, kind)
        if entry[k.EFFECT] == k.FLIP:
            for n in range(count_flips(8 * bytes_of, p)):
                shared.draws[n] = _draw(entry)
            flip_bits(work, payload + elements[row, k.OFFSET], 8 * bytes_of, p, shared.draws)
            new = read_element(at, bytes_of, kind)
        else:
            new = shared.factors[row, k.FACTOR] * _value_rule(
                entry[k.RULE], shared.values, i, t_s, p,
                shared.memory[place + i * (entry[k.REMEMBERS] - 1) :], _draw(entry),
            )  # fmt: skip
        saturated += write_element(at, bytes_of, kind, new)
        changed |= before != little_endian(at, bytes_of)
        largest = larger_change(largest, healthy, read_element(at, bytes_of, kind), scale)
    end = sent_length(work, payload, size, step[k.END])
    if end > size:
        work[base + 1] = end
        shared.items[item, k.LENGTH_OF] += end - size
    if changed:
        shared.items[item, k.ALTERED] = k.CHANGED
        _note_hit(entry, t_us, link, saturated, largest, shared)


@kernel
def _damage(item: int, head: int, step: Any, count: int, p: k.Doubles, shared: Shared) -> None:
    """Cut bytes off a frame in `work`, or change some, behind a checksum that is right before."""
    items, entry, base = shared.items, shared.entries[step[k.ENTRY]], item * k.SLOT
    whole = items[item, k.ALTERED] != k.DAMAGED
    if items[item, k.ALTERED] == k.CHANGED:
        items[item, k.ALTERED] = k.RESEALED  # the signature stays
    if whole and items[item, k.ALTERED]:
        seal(item, head, shared)
    if entry[k.EFFECT] == k.CUT:
        items[item, k.LENGTH_OF] = max(items[item, k.LENGTH_OF] - count, 1)
        items[item, k.ALTERED] = k.DAMAGED
        return
    at, size = base, items[item, k.LENGTH_OF]
    if whole and p[3] >= 0.0:
        at, size = base + head, i64(shared.work[base + 1])
    count = min(count, size)
    for n in range(2 * count):
        shared.draws[n] = _draw(entry)
    mix_bytes(shared.work, at, size, count, shared.draws)
    items[item, k.ALTERED] = k.CHANGED if whole and p[3] > 0.0 else k.DAMAGED


@kernel
def _act_on_frame(
    item: int, count: int, head: int, step: Any, place: int, t_us: int, link: int, shared: Shared
) -> int:
    """Apply a fault of the link to a frame in `work`; the frames that there are then."""
    work, items, entry = shared.work, shared.items, shared.entries[step[k.ENTRY]]
    u = _draw(entry)
    v = _draw(entry) if entry[k.DRAW_COUNT] > 1 else 0.0
    p, size = shared.numbers[step[k.NUMBERS_FROM] :], items[item, k.LENGTH_OF]
    memory = shared.memory[place:]
    number = i64(_link_rule(entry[k.RULE], np.float64(t_us), size, p, memory, u, v))
    if number == 0:
        return count
    late_us = i64(0)
    if entry[k.EFFECT] == k.DELAY:
        if number == LOST:
            items[item, k.LENGTH_OF] = 0
        else:
            late_us = number
            items[item, k.LATE_US] += number
    elif entry[k.EFFECT] == k.RENUMBER:
        place_of_seq = item * k.SLOT + (4 if head == 10 else 2)
        work[place_of_seq] = (i64(work[place_of_seq]) + number) & 0xFF
        items[item, k.ALTERED] = k.CHANGED
    elif entry[k.EFFECT] == k.CUT or entry[k.EFFECT] == k.MIX:
        _damage(item, head, step, number, p, shared)
    else:
        late_us = i64(p[3])
        for n in range(number):
            copy_bytes(work, item * k.SLOT, items[item, k.LENGTH_OF], work, count * k.SLOT)
            for column in range(3):
                items[count, column] = items[item, column]
            items[count, k.LATE_US] += late_us * (n + 1) // number
            count += 1
    largest = late_us * 1e-6 if late_us else -1.0
    _note_hit(entry, t_us, link, 0, largest, shared)
    return count


@kernel
def apply_chain(
    at: int, head: int, length: int, number: int, link: int, t_us: int, shared: Shared
) -> int:
    """Apply the entries of a message to a frame; how many frames it becomes."""
    work, items = shared.work, shared.items
    copy_bytes(shared.data, at, length, work, 0)
    items[0, k.LENGTH_OF], items[0, k.LATE_US], items[0, k.ALTERED] = length, 0, 0
    count = 1
    first, position = shared.table[number, k.CHAIN], 0
    while first >= 0:
        step, place = shared.steps[first], shared.places[position]
        entry = shared.entries[step[k.ENTRY]]
        if place == SIGNED:
            shared.memory[entry[k.COUNTS_AT] + hits.SEALED] += 1.0
        for item in range(count if place >= 0 else 0):
            damaged = items[item, k.ALTERED] == k.DAMAGED
            if items[item, k.LENGTH_OF] == 0 or (damaged and not entry[k.TAKES_BYTES]):
                continue
            probability = shared.chances[step[k.ENTRY]]
            if entry[k.CHANCE] >= 0 and draw(entry[k.CHANCE], entry[k.CHANCES_FROM]) >= probability:
                continue
            own_us = _own_time(entry, t_us, shared)
            if entry[k.ON_LINK]:  # it acts when the earlier entries let the frame go
                own_us += items[item, k.LATE_US]
            if entry[k.EFFECT] == k.VALUES or entry[k.EFFECT] == k.FLIP:
                _act_on_values(item, head, step, place, own_us, link, shared)
            else:
                count = _act_on_frame(item, count, head, step, place, own_us, link, shared)
        first = step[k.NEXT]
        position += 1
    return count


@kernel
def seal(item: int, head: int, shared: Shared) -> None:
    """Write the checksum of a changed frame in `work`, and its signature, if it has one."""
    base, address, loop = item * k.SLOT, shared.work.ctypes.data, shared.loop
    tail = base + head + i64(shared.work[base + 1])
    extra = np.uint64(loop[k.CRC_EXTRA])
    checksum = range_crc(address + base + 1, address + tail, extra, shared.crc)
    shared.work[tail] = checksum & np.uint64(0xFF)
    shared.work[tail + 1] = checksum >> np.uint64(8)
    if loop[k.SIGNATURE_AT]:
        sign_again(item, tail + 2, loop[k.SIGNATURE_AT], shared)
