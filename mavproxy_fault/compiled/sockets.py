"""The compiled path's sockets: wait, receive in batches, send in batches, all from within.

System calls are made from compiled code, so a busy stretch never returns to the interpreter. The
structures are those of 64-bit Linux: `mmsghdr` is eight 64-bit words, `pollfd` and `timespec` are
one and two.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
import numpy as np
from numba import carray, njit, types

from mavproxy_fault.compiled.frames import check, take
from mavproxy_fault.compiled.layout import (
    AT,
    BASE,
    BATCH,
    BLOCK,
    BYTES,
    BYTES_SENT,
    CAME,
    COUNT,
    DATAGRAMS,
    DEADLINE,
    DROPS,
    DUE_AT,
    DUE_COUNT,
    DUE_SENT,
    ERRORS,
    FAST,
    FD,
    FROM_VEHICLE,
    HEADERS_AT,
    HEADS_AT,
    IDS,
    KEEP,
    LATENCY_STEPS,
    LINK,
    LINK_COUNT,
    LISTENS,
    LOG_FULL,
    LOG_MARGIN,
    LOG_SIZE,
    LONE,
    MOST_DRAWN,
    MOST_PIECES,
    MOST_PLANS,
    NAME,
    NANOSECONDS,
    NOT_PLAIN,
    OTHER_READY,
    PEER_COUNT,
    PEERS,
    PEERS_AT,
    PLAN_SIZE,
    POLLS,
    POLLS_AT,
    PORT_SIZE,
    PRECISE,
    RECEIVED_AT,
    ROW,
    SECONDS,
    SENT,
    SENT_AT,
    SOCKADDR_IN,
    SPIN,
    TIME_AT,
    TIME_IS_UP,
    TURN_SIZE,
)
from mavproxy_fault.proxy.senders import SIZE

DONTWAIT = 0x40
MONOTONIC = 1  # clock
EARLY_NS = 250_000  # a sleep may end so late
LOOK_EVERY = 63  # turns of a spinning loop between looks at what is no UDP link

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


@njit(error_model="numpy", forceinline=True)
def _now_ns(turn):
    _clock_gettime(MONOTONIC, turn[TIME_AT])
    return turn[SECONDS] * 1_000_000_000 + turn[NANOSECONDS]


@njit(error_model="numpy", forceinline=True)
def _peer(names, peers, count):
    """Which known peer a datagram came from, -1 if from none."""
    for peer in range(count):
        same = True
        for k in range(SOCKADDR_IN):
            if names[k] != peers[peer, k]:
                same = False
                break
        if same:
            return peer
    return -1


@njit(error_model="numpy", forceinline=True)
def _send(first, last, source, link, turn, net):
    """Send rows of `source` to all peers of a link."""
    ports, headers, parts = net[0], net[2], net[3]
    headers_at = turn[HEADERS_AT] + 64 * BATCH * source
    count = last - first
    length = np.int64(0)
    for k in range(first, last):
        length += parts[source, k, 1]
    listens = ports[link, LISTENS]
    if listens and ports[link, PEER_COUNT] == 0:
        ports[link, DROPS] += count
        return
    for peer in range(ports[link, PEER_COUNT] if listens else 1):
        for k in range(first, last):
            headers[source, k, 0] = turn[PEERS_AT] + NAME * (PEERS * link + peer) if listens else 0
            headers[source, k, 1] = SOCKADDR_IN if listens else 0
        done = first
        refused = False
        while done < last:
            went = _sendmmsg(ports[link, FD], headers_at + 64 * done, last - done, DONTWAIT)
            if went > 0:
                done += went
                ports[link, SENT] += went
            elif not refused:  # an error of an earlier datagram, now reported: try again
                refused = True
                ports[link, ERRORS] += 1
            else:
                ports[link, DROPS] += 1
                refused = False
                done += 1
        ports[link, BYTES_SENT] += length


@njit(error_model="numpy", forceinline=True)
def _receive(link, turn, net):
    """Fill a link's rows; whether anything came.

    After a lone datagram the next is likely to be alone too, and is had sooner without an attempt
    at a second one; the call after that looks whether there is a batch.
    """
    ports, heads, parts = net[0], net[1], net[3]
    heads_at = turn[HEADS_AT] + 64 * BATCH * link
    count = np.int64(1)
    if ports[link, LONE]:
        name, name_size = heads[link, 0, 0], heads_at + 8
        length = _recvfrom(ports[link, FD], parts[link, 0, 0], ROW, DONTWAIT, name, name_size)
        if length < 0:
            return False
        heads[link, 0, 7] = length
        ports[link, LONE] = 0
    else:
        count = np.int64(_recvmmsg(ports[link, FD], heads_at, BATCH, DONTWAIT, 0))
        ports[link, LONE] = count <= 1
        if count <= 0:
            return False
    turn[LINK], turn[AT], turn[COUNT] = link, 0, count
    ports[link, DATAGRAMS] += count
    for k in range(count):
        ports[link, BYTES] += heads[link, k, 7] & 0xFFFFFFFF
        heads[link, k, 1] = NAME  # room for the next name; the kernel wrote the length of this one
    return True


@njit(error_model="numpy", forceinline=True)
def _run(link, fast, now_us, turn, net, wire):
    """Take rows as long as they go to the same links; those, and whether the next row is plain."""
    ports, heads, parts, names, peers, heard = net[0], net[1], net[3], net[4], net[5], net[6]
    everywhere = (np.int64(1) << ports.shape[0]) - 1
    found = np.int64(-1)
    while turn[AT] < turn[COUNT]:
        at = turn[AT]
        length = heads[link, at, 7] & 0xFFFFFFFF
        start = (link * BATCH + at) * ROW
        peer = 0
        if ports[link, LISTENS]:
            peer = _peer(names[link, at], peers[link], ports[link, PEER_COUNT])
        mask = np.int64(-1)
        if peer >= 0 and length > 0:
            bit, way = np.int64(1) << link, ports[link, FROM_VEHICLE]
            mask = check(start, length, bit, fast, way, everywhere, turn, wire)
        if mask < 0 or (found >= 0 and mask != found):
            return found, mask >= 0
        found = mask
        heard[link, peer] = 1
        take(start, length, link, mask, now_us, ports, turn, wire)
        parts[link, at, 1] = length
        turn[AT] = at + 1
    return found, True


@njit(error_model="numpy", forceinline=True)
def _drain(link, histogram, turn, net, wire):
    """Pass on one batch of a link; False if it stopped at a datagram that is not plain."""
    ports = net[0]
    started = turn[CAME] = _now_ns(turn)
    if turn[AT] >= turn[COUNT] and not _receive(link, turn, net):
        return True
    fast = np.int64(0)
    for other in range(ports.shape[0]):
        fast |= ports[other, FAST] << other
    begun = turn[AT]
    plain = True
    while plain and turn[AT] < turn[COUNT]:
        first = turn[AT]
        mask, plain = _run(link, fast, (turn[BASE] + started) // 1000, turn, net, wire)
        if mask > 0:
            for other in range(ports.shape[0]):
                if mask >> other & 1:
                    _send(first, turn[AT], link, other, turn, net)
    spent = max(_now_ns(turn) - started, 16)
    octave = np.int64(0)
    while spent >> octave:
        octave += 1
    histogram[link, octave << 3 | spent >> (octave - 4) & 7] += turn[AT] - begun
    return plain


@njit(error_model="numpy", forceinline=True)
def _wait(left, turn):
    """Look at all descriptors, and sleep until one has something; False if a signal came."""
    turn[SECONDS], turn[NANOSECONDS] = left // 1_000_000_000, left % 1_000_000_000
    return _ppoll(turn[POLLS_AT], turn[POLLS], turn[TIME_AT], 0) >= 0


@njit(error_model="numpy", forceinline=True)
def _forward(histogram, polls, turn, net, wire):
    """Forward until the deadline, or until something is left to the plain path; says which."""
    ports, heads = net[0], net[1]
    count = ports.shape[0]
    turns = np.int64(0)
    if turn[DUE_COUNT]:
        while _now_ns(turn) < turn[DUE_AT]:
            pass
        for at in range(turn[DUE_COUNT]):
            _send(at, at + 1, count, heads[count, at, 7], turn, net)
        turn[DUE_COUNT] = 0
        return DUE_SENT
    while True:
        if turn[KEEP] and max(turn[RECEIVED_AT], turn[SENT_AT]) > LOG_SIZE - LOG_MARGIN:
            return LOG_FULL
        left = turn[DEADLINE] - _now_ns(turn)
        if left <= 0:
            return TIME_IS_UP
        link = turn[LINK]
        other_ready = False
        look = turn[SPIN] == 0 or turns & LOOK_EVERY == 0
        turns += 1
        if turn[AT] >= turn[COUNT]:
            link = np.int64(0)
            if look:
                # A processor takes its time to wake: before a due frame sleep less, then stay up.
                early = EARLY_NS if turn[PRECISE] else 0
                if not _wait(0 if turn[SPIN] else max(left - early, 0), turn):
                    return TIME_IS_UP
                for k in range(count, turn[POLLS]):
                    other_ready |= polls[k] >> 48 != 0
        while link < count:
            if ports[link, FAST]:
                ready = turn[AT] < turn[COUNT] or turn[SPIN] != 0 or polls[link] >> 48 != 0
                while ready:
                    ready = ports[link, LONE] != 0
                    if not _drain(link, histogram, turn, net, wire):
                        return NOT_PLAIN
                    ready &= ports[link, LONE] == 0  # it was a lone one: look for more
            elif look and polls[link] >> 48 != 0:
                other_ready = True
            link += 1
        if other_ready:
            return OTHER_READY


def forward(
    histogram, polls, turn, ports, heads, headers, parts, names, peers, heard, data, memory, table,
    plans, received, sent, index, numbers, hits, steps, crc, result, pieces, draws,
):  # fmt: skip
    """`_forward` on arrays given by their addresses, in the order of `fast.ARRAYS`."""
    links = carray(turn, (TURN_SIZE,))[LINK_COUNT]
    net = (
        carray(ports, (links, PORT_SIZE)),
        carray(heads, (links + 1, BATCH, 8)),
        carray(headers, (links + 1, BATCH, 8)),
        carray(parts, (links + 1, BATCH, 2)),
        carray(names, (links, BATCH, NAME)),
        carray(peers, (links, PEERS, NAME)),
        carray(heard, (links, PEERS)),
    )
    wire = (
        carray(data, (links * BATCH * ROW,)),
        carray(memory, (SIZE,)),
        carray(table, (IDS, 8)),
        carray(plans, (MOST_PLANS, PLAN_SIZE)),
        carray(received, (LOG_SIZE,)),
        carray(sent, (LOG_SIZE,)),
        carray(index, (LOG_SIZE // 2,)),
        carray(numbers, (MOST_PLANS, 2)),
        carray(hits, (MOST_PLANS, 4)),
        carray(steps, (MOST_PLANS,)),
        carray(crc, (8, 256)),
        carray(result, (2,)),
        carray(pieces, (MOST_PIECES, 4)),
        carray(draws, (MOST_DRAWN * BLOCK,)),
    )
    return _forward(
        carray(histogram, (links, LATENCY_STEPS)),
        carray(polls, (carray(turn, (TURN_SIZE,))[POLLS],)),
        carray(turn, (TURN_SIZE,)),
        net,
        wire,
    )
