"""The compiled form's faults: elements of a frame read, changed and written back in place.

Each rule has its twin in the interpreted way, which with Python's own numbers takes less than half
the time of these functions without a compiler (docs/compiled.md): `_met` is `faults.driven.meet`,
`_changed` is `fault_parts.draft.Draft.write`, `_segment` is `fault_parts.profile.at`, `_is_for` is
`ActiveEntry.matches`. A property test compares the two: same bytes, labels and counters.
"""

import math
from typing import Any

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.kernel import i64, kernel
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.wire.frame import FLOAT_MAX
from mavproxy_fault.wire.framing import range_crc


@kernel
def little(data: k.Octets, at: int, size: int) -> Any:
    """A little-endian number of `size` bytes."""
    value = i64(0)
    for n in range(size):
        value |= i64(data[at + n]) << (8 * n)
    return value


@kernel
def _size(code: int) -> int:
    """Bytes of one element, by its `struct` code."""
    if code == 98 or code == 66:  # b, B
        return 1
    if code == 104 or code == 72:  # h, H
        return 2
    return 8 if code == 100 else 4  # d; f, i, I


@kernel
def _met(mode: int, healthy: float, value: float) -> float:
    """The faulty value."""
    if mode == k.ADD:
        return healthy + value
    return healthy * value if mode == k.SCALE else value


@kernel
def _changed_integer(before: int, code: int, mode: int, value: float, outcome: k.Doubles) -> int:
    """The bits of an integer after a fault, at the nearest limit where they do not fit."""
    bits = 8 * _size(code)
    signed = code > 96  # lower case
    healthy = before
    if signed and before >> (bits - 1):
        healthy = before - (i64(1) << bits)
    low = -(i64(1) << (bits - 1)) if signed else i64(0)
    high = (i64(1) << (bits - 1 if signed else bits)) - 1
    new = _met(mode, np.float64(healthy), value)
    stored = i64(0)
    if np.isnan(new):
        outcome[k.CUT] = 1.0
    else:
        outcome[k.CUT] = 0.0 if low - 0.5 <= new <= high + 0.5 else 1.0
        stored = low if new <= low else high if new >= high else i64(np.rint(new))
    outcome[k.STEP] = abs(np.float64(stored - healthy))
    return stored & ((i64(1) << bits) - 1)


@kernel
def _changed(before: Any, code: int, mode: int, value: float, outcome: k.Doubles) -> Any:
    """The bits of one element after a fault; size of the step and saturation go to `outcome`."""
    outcome[k.CUT] = 0.0
    if code == 102:  # f
        healthy = np.float64(np.uint32(before).view(np.float32))
        new = _met(mode, healthy, value)
        if np.isfinite(new) and abs(new) > FLOAT_MAX:
            outcome[k.CUT] = 1.0
            new = FLOAT_MAX if new > 0 else -FLOAT_MAX
        single = np.float32(new)
        outcome[k.STEP] = abs(np.float64(single) - healthy)
        return i64(single.view(np.uint32))
    if code == 100:  # d
        double = np.uint64(before).view(np.float64)
        new = _met(mode, double, value)
        outcome[k.STEP] = abs(new - double)
        return i64(np.float64(new).view(np.uint64))
    return _changed_integer(before, code, mode, value, outcome)


@kernel
def _segment(plan: k.Integers, otherwise: float, t_s: float, segments: k.Doubles) -> float:
    """The piecewise-linear function of a plan; NaN where it is silent."""
    first = plan[k.SEGMENTS_FROM]
    found = first - 1
    for n in range(first, plan[k.SEGMENTS_TO]):
        if plan[k.OPEN_LEFT]:
            if t_s <= segments[n, k.AT_S]:
                break
            found = n
        elif segments[n, k.AT_S] <= t_s:
            found = n
    if found < first or not t_s <= segments[found, k.AT_S] + segments[found, k.FOR_S]:
        return otherwise
    one = segments[found]
    return float(one[k.AT_START] + (t_s - one[k.AT_S]) * one[k.RATE])


@kernel
def _given(plan: k.Integers, row: int, t_s: float, shared: Shared) -> float:
    """The number that meets a row's healthy value; NaN where a function of time is silent."""
    value, limit = shared.numbers[row, k.VALUE], shared.numbers[row, k.LIMIT]
    if plan[k.SOURCE] == k.SEGMENTS:
        return _segment(plan, limit, t_s, shared.segments)
    if plan[k.SOURCE] == k.GROWS:
        return float(max(-limit, min(limit, value * t_s)))
    return float(value)


@kernel
def _is_for(plan: k.Integers, sender: int, from_vehicle: int) -> bool:
    """Whether a planned fault's `where` lets the sender through."""
    return bool(
        (plan[k.SYSTEM] < 0 or plan[k.SYSTEM] == sender >> 8)
        and (plan[k.COMPONENT] < 0 or plan[k.COMPONENT] == sender & 0xFF)
        and (plan[k.DIRECTION] < 0 or plan[k.DIRECTION] == from_vehicle)
    )


@kernel
def _is_known(
    payload: int, size: int, first: int, sender: int, from_vehicle: int, shared: Shared
) -> bool:
    """Whether the plan holds the fault's state for this sender, and its elements were not cut."""
    plan = shared.plans[first]
    if plan[k.KNOWN_SENDER] >= 0 and plan[k.KNOWN_SENDER] != sender:
        return False
    if plan[k.KNOWN_WAY] >= 0 and plan[k.KNOWN_WAY] != from_vehicle:
        return False
    if plan[k.INSTANCE_AT] >= 0:
        length = min(plan[k.INSTANCE_SIZE], size - plan[k.INSTANCE_AT])
        if little(shared.data, payload + plan[k.INSTANCE_AT], length) != plan[k.INSTANCE]:
            return False
    for row in range(first, first + plan[k.ROWS]):
        if shared.plans[row, k.OFFSET] + _size(shared.plans[row, k.CODE]) > size:
            return False
    return True


@kernel
def _would_act(payload: int, first: int, t_us: int, shared: Shared) -> bool:
    """Whether a fault that has done nothing yet would change a frame, which is handed over then."""
    plan = shared.plans[first]
    if plan[k.SOURCE] == k.DRAWN:
        return True
    t_s = (t_us - plan[k.START]) / 1e6
    for row in range(first, first + plan[k.ROWS]):
        value = _given(plan, row, t_s, shared)
        code = shared.plans[row, k.CODE]
        before = little(shared.data, payload + shared.plans[row, k.OFFSET], _size(code))
        silent = plan[k.SOURCE] == k.SEGMENTS and np.isnan(value)
        if not silent and _changed(before, code, plan[k.MODE], value, shared.outcome) != before:
            return True
    return False


@kernel
def draws_for(
    payload: int, size: int, first: int, sender: int, link: int, t_us: int, shared: Shared
) -> int:
    """How many drawn numbers the faults of a message need, -1 if one of them cannot go this way."""
    loop, from_vehicle = shared.loop, shared.ports[link, k.FROM_VEHICLE]
    needed = i64(0)
    while first >= 0:
        plan = shared.plans[first]
        if _is_for(plan, sender, from_vehicle):
            if not _is_known(payload, size, first, sender, from_vehicle, shared):
                return -1
            if plan[k.WAITS] > 0 and _would_act(payload, first, t_us, shared):
                return -1
            if plan[k.SOURCE] == k.DRAWN:
                needed += plan[k.ROWS]
                used = shared.hits[first, k.USED]
                if used + loop[k.DRAWS] + needed > k.BLOCK:
                    loop[k.DRY] = used
                    return -1
        first = plan[k.NEXT]
    return needed


@kernel
def _act(payload: int, first: int, t_us: int, shared: Shared) -> bool:
    """Apply one planned fault to a frame; whether a byte changed."""
    data, plans, hits, outcome = shared.data, shared.plans, shared.hits[first], shared.outcome
    plan = plans[first]
    t_s = (t_us - plan[k.START]) / 1e6
    changed = False
    saturated = 0
    largest = -1.0
    for row in range(first, first + plan[k.ROWS]):
        value = _given(plan, row, t_s, shared)
        if plan[k.SOURCE] == k.SEGMENTS and np.isnan(value):
            return False
        if plan[k.SOURCE] == k.DRAWN:
            value *= shared.draws[plan[k.DRAWS_FROM] + hits[k.USED]]
            hits[k.USED] += 1
        at, code = payload + plans[row, k.OFFSET], plans[row, k.CODE]
        size = _size(code)
        before = little(data, at, size)
        after = _changed(before, code, plan[k.MODE], value, outcome)
        for n in range(size):
            data[at + n] = after >> (8 * n) & 0xFF
        changed |= after != before
        saturated += int(outcome[k.CUT])
        if math.isfinite(outcome[k.STEP]):
            largest = max(largest, outcome[k.STEP])
    if changed:
        hits[k.FRAMES_HIT] += 1
        hits[k.SATURATED] += saturated
        shared.steps[first] = max(shared.steps[first], largest)
    return changed


@kernel
def patch(at: int, head: int, size: int, number: int, link: int, t_us: int, shared: Shared) -> bool:
    """Apply the planned faults of a frame's message one after the other; whether it changed."""
    data, plans, entry = shared.data, shared.plans, shared.table[number]
    from_vehicle = shared.ports[link, k.FROM_VEHICLE]
    place = at + (5 if head == 10 else 3)
    sender = i64(data[place]) << 8 | i64(data[place + 1])
    changed = False
    first = entry[k.PLAN]
    while first >= 0:
        if _is_for(plans[first], sender, from_vehicle):
            changed |= _act(at + head, first, t_us, shared)
        first = plans[first, k.NEXT]
    if changed:
        tail, base = at + head + size, data.ctypes.data
        checksum = range_crc(base + at + 1, base + tail, np.uint64(entry[k.EXTRA]), shared.crc)
        data[tail] = checksum & np.uint64(0xFF)
        data[tail + 1] = checksum >> np.uint64(8)
    return changed
