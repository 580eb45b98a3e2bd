"""The compiled form's sockets: wait, receive in batches, send in batches, all from within.

System calls are made from compiled code, so a busy stretch never returns to the interpreter. The
structures are those of 64-bit Linux: `mmsghdr` is eight 64-bit words, `pollfd` and `timespec` are
one and two.
"""

from typing import Any

from numba import types

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.frames import pass_datagram
from mavproxy_fault.compiled.kernel import i64, kernel
from mavproxy_fault.compiled.layout import Shared

DONTWAIT = 0x40
MONOTONIC = 1  # clock
EARLY_NS = 250_000  # a sleep may end so late
LOOK_EVERY = 63  # rounds of a spinning loop between looks at what is no UDP link

_recvfrom = types.ExternalFunction(
    "recvfrom",
    types.intp(types.intc, types.intp, types.uintp, types.intc, types.intp, types.intp),
)
_recvmmsg = types.ExternalFunction(
    "recvmmsg", types.intc(types.intc, types.intp, types.uintc, types.intc, types.intp)
)
_sendmmsg = types.ExternalFunction(
    "sendmmsg", types.intc(types.intc, types.intp, types.uintc, types.intc)
)
_ppoll = types.ExternalFunction(
    "ppoll", types.intc(types.intp, types.uintp, types.intp, types.intp)
)
_clock_gettime = types.ExternalFunction("clock_gettime", types.intc(types.intc, types.intp))


@kernel
def _now_ns(loop: k.Integers) -> Any:
    _clock_gettime(MONOTONIC, loop[k.TIME_AT])
    return loop[k.SECONDS] * 1_000_000_000 + loop[k.NANOSECONDS]


@kernel
def _peer(link: int, row: int, shared: Shared) -> int:
    """Which known peer of a link a datagram came from, -1 if from none."""
    names, peers = shared.names[link, row], shared.peers[link]
    for peer in range(shared.ports[link, k.PEER_COUNT]):
        same = True
        for n in range(shared.ports[link, k.NAME_SIZE]):
            if names[n] != peers[peer, n]:
                same = False
                break
        if same:
            return peer
    return -1


@kernel
def _send_to(first: int, last: int, source: int, link: int, shared: Shared) -> None:
    """Hand rows of `source`, whose addresses are set, to the kernel; what it refuses is dropped."""
    ports = shared.ports
    headers_at = shared.loop[k.HEADERS_AT] + 8 * k.HEADER * k.BATCH * source
    done = first
    refused = False
    while done < last:
        at = headers_at + 8 * k.HEADER * done
        went = _sendmmsg(ports[link, k.FD], at, last - done, DONTWAIT)
        if went > 0:
            done += went
            ports[link, k.SENT] += went
        elif not refused:  # an error of an earlier datagram, now reported: try again
            refused = True
            ports[link, k.ERRORS] += 1
        else:
            ports[link, k.DROPS] += 1
            refused = False
            done += 1


@kernel
def _send(first: int, last: int, source: int, link: int, shared: Shared) -> None:
    """Send rows of `source` to all peers of a link."""
    ports, headers = shared.ports, shared.headers
    length = i64(0)
    for row in range(first, last):
        length += shared.parts[source, row, k.DATA_LENGTH]
    listens = ports[link, k.LISTENS]
    if listens and ports[link, k.PEER_COUNT] == 0:
        ports[link, k.DROPS] += last - first
        return
    for peer in range(ports[link, k.PEER_COUNT] if listens else 1):
        name_at = shared.loop[k.PEERS_AT] + k.NAME * (k.PEERS * link + peer)
        for row in range(first, last):
            headers[source, row, k.NAME_AT] = name_at if listens else 0
            headers[source, row, k.NAME_LENGTH] = ports[link, k.NAME_SIZE] if listens else 0
        _send_to(first, last, source, link, shared)
        ports[link, k.BYTES_SENT] += length


@kernel
def _receive(link: int, shared: Shared) -> bool:
    """Fill a link's rows; whether anything came.

    After a lone datagram the next is likely to be alone too, and is had sooner without an attempt
    at a second one; the call after that looks whether there is a batch.
    """
    loop, ports, heads = shared.loop, shared.ports, shared.heads[link]
    heads_at = loop[k.HEADS_AT] + 8 * k.HEADER * k.BATCH * link
    count = i64(1)
    if ports[link, k.LONE]:
        data_at = shared.data.ctypes.data + link * k.BATCH * k.ROW
        name_at = heads[0, k.NAME_AT]
        length_at = heads_at + 8 * k.NAME_LENGTH
        length = _recvfrom(ports[link, k.FD], data_at, k.ROW, DONTWAIT, name_at, length_at)
        if length < 0:
            return False
        heads[0, k.LENGTH] = length
        ports[link, k.LONE] = 0
    else:
        count = i64(_recvmmsg(ports[link, k.FD], heads_at, k.BATCH, DONTWAIT, 0))
        ports[link, k.LONE] = count <= 1
        if count <= 0:
            return False
    loop[k.LINK], loop[k.AT], loop[k.COUNT] = link, 0, count
    ports[link, k.DATAGRAMS] += count
    for row in range(count):
        ports[link, k.BYTES] += heads[row, k.LENGTH] & 0xFFFFFFFF
        heads[row, k.NAME_LENGTH] = k.NAME  # the kernel wrote the length of this name there
    return True


@kernel
def _begin_output(rows: int, loop: k.Integers) -> None:
    """Begin a link's outgoing segments anew."""
    loop[k.OUT_AT], loop[k.OUT_END] = rows * k.BATCH * k.ROW, (rows + 1) * k.BATCH * k.ROW
    loop[k.SEGMENT] = loop[k.OPEN] = loop[k.OTHERS] = 0


@kernel
def _send_segments(link: int, shared: Shared) -> None:
    """Send a link's outgoing segments, those for the same links together."""
    loop, masks = shared.loop, shared.masks[link]
    first = i64(0)
    while first < loop[k.SEGMENT]:
        last = first + 1
        while last < loop[k.SEGMENT] and masks[last] == masks[first]:
            last += 1
        for towards in range(loop[k.LINK_COUNT]):
            if masks[first] & loop[k.COMPILED_LINKS] & 1 << towards:
                _send(first, last, link, towards, shared)
        first = last


@kernel
def _pass_rows(link: int, rows: int, shared: Shared) -> int:
    """Pass the datagrams of some rows; DONE, or what became of the one that it stopped at."""
    loop, ports = shared.loop, shared.ports
    now_us = (loop[k.BASE] + loop[k.CAME]) // 1000
    _begin_output(rows, loop)
    found = k.DONE
    while found == k.DONE and loop[k.AT] < loop[k.COUNT]:
        row = loop[k.AT]
        length = shared.heads[rows, row, k.LENGTH] & 0xFFFFFFFF
        peer = _peer(link, row, shared) if rows == link and ports[link, k.LISTENS] else 0
        found = k.REST
        if peer >= 0 and length > 0:
            start = (rows * k.BATCH + row) * k.ROW
            found = pass_datagram(start, length, link, rows, now_us, shared)
            if loop[k.ROW_AT]:
                shared.heard[link, peer] = 1
        if found == k.DONE:
            loop[k.AT] = row + 1
            loop[k.ROW_AT] = 0 if rows == link else length
    loop[k.FOUND] = found
    return found


@kernel
def _give_back(length: int, found: int, shared: Shared) -> None:
    """Put what became of a lent chunk in its place, if all of it leaves together at once; MASK are
    then its links, else UNTOUCHED or BEGUN."""
    loop, rows = shared.loop, shared.loop[k.LINK_COUNT]
    start = rows * k.BATCH * k.ROW
    loop[k.MASK] = k.BEGUN if loop[k.ROW_AT] else k.UNTOUCHED
    if loop[k.HELD_AT]:
        return
    if found == k.DONE and loop[k.SEGMENT] <= 1 and loop[k.OUT_AT] in (start, start + length):
        loop[k.MASK] = shared.masks[rows, 0] if loop[k.SEGMENT] else 0
        for n in range(loop[k.OUT_AT] - start):
            shared.data[start + n] = shared.outs[start + n]


@kernel
def _drain(link: int, lent: int, shared: Shared) -> int:
    """Pass on one batch of a link, or what is lent in its name; the reason to return, -1 for
    none."""
    loop = shared.loop
    started = _now_ns(loop)
    if loop[k.AT] >= loop[k.COUNT]:
        if not _receive(link, shared):
            return -1
        loop[k.CAME] = started  # of the whole batch, however often it is interrupted
        if started >= loop[k.DEADLINE]:  # what was due before it leaves before it
            return k.TIME_IS_UP
    begun = loop[k.AT]
    found = _pass_rows(link, loop[k.LINK_COUNT] if lent else link, shared)
    if lent:
        _give_back(lent, found, shared)
        return k.LENT_PASSED
    _send_segments(link, shared)
    spent = max(_now_ns(loop) - started, 16)
    octave = i64(0)
    while spent >> octave:
        octave += 1
    shared.histogram[link, octave << 3 | spent >> (octave - 4) & 7] += loop[k.AT] - begun
    if found == k.DONE:
        return k.TO_SETTLE if loop[k.OTHERS] else -1
    return k.TO_SETTLE if found == k.NEWS or found == k.FULL else k.HANDED_OVER


@kernel
def _wait(remaining_ns: int, loop: k.Integers) -> bool:
    """Look at all descriptors, and sleep until one has something; False if a signal came."""
    loop[k.SECONDS] = remaining_ns // 1_000_000_000
    loop[k.NANOSECONDS] = remaining_ns % 1_000_000_000
    return bool(_ppoll(loop[k.POLLS_AT], loop[k.POLLS], loop[k.TIME_AT], 0) >= 0)


@kernel
def _send_due(shared: Shared) -> None:
    """Send the rows after the links' at the requested time."""
    loop, rows = shared.loop, shared.loop[k.LINK_COUNT]
    while _now_ns(loop) < loop[k.DUE_AT]:
        pass
    for at in range(loop[k.DUE_COUNT]):
        _send(at, at + 1, rows, shared.heads[rows, at, k.LENGTH], shared)
    loop[k.DUE_COUNT] = 0


@kernel
def _drain_links(first: int, look: bool, lent: int, shared: Shared) -> int:
    """Drain the links from `first` on; the reason to return, -1 for none."""
    loop, ports, polls = shared.loop, shared.ports, shared.polls
    reason = -1
    for link in range(first, loop[k.LINK_COUNT]):
        if ports[link, k.COMPILED] or lent:
            ready = loop[k.AT] < loop[k.COUNT] or loop[k.SPIN] != 0 or polls[link] >> 48 != 0
            while ready:
                ready = ports[link, k.LONE] != 0
                found = _drain(link, lent, shared)
                if found >= 0:
                    return found
                ready &= ports[link, k.LONE] == 0  # it was a lone one: look for more
        elif look and polls[link] >> 48 != 0:
            reason = k.OTHER_READY
    return reason


def forward(shared: Shared) -> int:
    """Forward until the deadline, or until something is to be handed over; says which."""
    loop = shared.loop
    rounds = i64(0)
    if loop[k.DUE_COUNT]:
        _send_due(shared)
        return k.DUE_SENT
    lent = loop[k.LENT]
    if lent:
        shared.heads[loop[k.LINK_COUNT], 0, k.LENGTH] = lent
        loop[k.LENT], loop[k.AT], loop[k.COUNT], loop[k.ROW_AT] = 0, 0, 1, 0
    while True:
        remaining_ns = loop[k.DEADLINE] - _now_ns(loop)
        if remaining_ns <= 0 and not lent:
            return k.TIME_IS_UP
        first = loop[k.LINK]
        reason = -1
        look = loop[k.SPIN] == 0 or rounds & LOOK_EVERY == 0
        rounds += 1
        if loop[k.AT] >= loop[k.COUNT]:
            first = i64(0)
            if look:
                # A processor takes its time to wake: before a due frame sleep less, then stay up.
                early = EARLY_NS if loop[k.PRECISE] else 0
                if not _wait(0 if loop[k.SPIN] else max(remaining_ns - early, 0), loop):
                    return k.TIME_IS_UP
                for n in range(loop[k.LINK_COUNT], loop[k.POLLS]):
                    if shared.polls[n] >> 48 != 0:
                        reason = k.OTHER_READY
        drained = _drain_links(first, look, lent, shared)
        if drained >= 0:
            reason = drained
        if reason >= 0:
            return reason
