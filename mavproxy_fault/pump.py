"""The compiled path's sockets: wait, receive in batches, send in batches, all from within.

System calls are made from compiled code, so a busy stretch never returns to the interpreter. The
structures are those of 64-bit Linux: `mmsghdr` is eight 64-bit words.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
import numpy as np
from numba import njit, types

from mavproxy_fault.kernel import (
    AT,
    BASE,
    BATCH,
    BYTES,
    BYTES_SENT,
    COUNT,
    DATAGRAMS,
    DEADLINE,
    DROPS,
    ERRORS,
    FAST,
    FD,
    KEEP,
    LINK,
    LISTENS,
    LOG_FULL,
    LOG_MARGIN,
    LOG_SIZE,
    NAME,
    NANOSECONDS,
    NOT_PLAIN,
    OTHER_READY,
    PEER_COUNT,
    POLLS,
    RECEIVED_AT,
    ROW,
    SECONDS,
    SENT,
    SENT_AT,
    SPIN,
    TIME_IS_UP,
    check,
    take,
)

DONTWAIT = 0x40

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


@njit(cache=True, nogil=True)
def _now_ns(turn):
    _clock_gettime(1, turn[SECONDS:].ctypes.data)
    return turn[SECONDS] * 1_000_000_000 + turn[NANOSECONDS]


@njit(cache=True, nogil=True)
def _peer(names, peers, count):
    """Which known peer a datagram came from, -1 if from none."""
    for peer in range(count):
        same = True
        for k in range(16):
            if names[k] != peers[peer, k]:
                same = False
                break
        if same:
            return peer
    return -1


@njit(cache=True, nogil=True)
def _send(first, last, source, link, net):
    """Send rows of `source` to all peers of a link."""
    ports, headers, parts, peers, name_lengths = net[0], net[2], net[3], net[5], net[6]
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
            headers[source, k, 0] = peers[link, peer].ctypes.data if listens else 0
            headers[source, k, 1] = name_lengths[link] if listens else 0
        done = first
        refused = False
        while done < last:
            went = _sendmmsg(
                ports[link, FD], headers[source, done].ctypes.data, last - done, DONTWAIT
            )
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


@njit(cache=True, nogil=True)
def _receive(link, turn, net):
    """Fill a link's rows; whether anything came."""
    ports, heads = net[0], net[1]
    count = _recvmmsg(ports[link, FD], heads[link].ctypes.data, BATCH, DONTWAIT, 0)
    if count <= 0:
        return False
    turn[LINK], turn[AT], turn[COUNT] = link, 0, count
    ports[link, DATAGRAMS] += count
    for k in range(count):
        ports[link, BYTES] += heads[link, k, 7] & 0xFFFFFFFF
        heads[link, k, 1] = NAME  # room for the next name; the kernel wrote the length of this one
    return True


@njit(cache=True, nogil=True)
def _run(link, fast, now_us, turn, net, wire):
    """Take rows as long as they go to the same links; those, and whether the next row is plain."""
    ports, heads, parts, names, peers, heard = net[0], net[1], net[3], net[4], net[5], net[7]
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
            mask = check(start, length, np.int64(1) << link, fast, everywhere, turn, wire)
        if mask < 0 or (found >= 0 and mask != found):
            return found, mask >= 0
        found = mask
        heard[link, peer] = 1
        take(start, length, link, mask, now_us, ports, turn, wire)
        parts[link, at, 1] = length
        turn[AT] = at + 1
    return found, True


@njit(cache=True, nogil=True)
def _drain(link, histogram, turn, net, wire):
    """Pass on one batch of a link; False if it stopped at a datagram that is not plain."""
    ports = net[0]
    started = _now_ns(turn)
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
                    _send(first, turn[AT], link, other, net)
    spent = max(_now_ns(turn) - started, 16)
    octave = np.int64(0)
    while spent >> octave:
        octave += 1
    histogram[link, octave << 3 | spent >> (octave - 4) & 7] += turn[AT] - begun
    return plain


@njit(cache=True, nogil=True)
def _wait(now, polls, turn, rest):
    """Sleep until something comes or the deadline; False if a signal came."""
    left = turn[DEADLINE] - now
    rest[0], rest[1] = left // 1_000_000_000, left % 1_000_000_000
    return _ppoll(polls.ctypes.data, turn[POLLS], rest.ctypes.data, 0) >= 0


@njit(cache=True, nogil=True)
def forward(histogram, polls, turn, net, wire):
    """Forward until the deadline, or until something is left to the plain path; says which."""
    ports = net[0]
    count = ports.shape[0]
    rest = np.zeros(2, np.int64)
    while True:
        if turn[KEEP] and max(turn[RECEIVED_AT], turn[SENT_AT]) > LOG_SIZE - LOG_MARGIN:
            return LOG_FULL
        now = _now_ns(turn)
        if now >= turn[DEADLINE]:
            return TIME_IS_UP
        link = turn[LINK]
        other_ready = False
        if turn[AT] >= turn[COUNT]:
            link = np.int64(0)
            if turn[SPIN] == 0:
                if not _wait(now, polls, turn, rest):
                    return TIME_IS_UP
                for k in range(count, turn[POLLS]):
                    other_ready |= polls[k] >> 48 != 0
        while link < count:
            ready = turn[AT] < turn[COUNT] or turn[SPIN] or polls[link] >> 48 != 0
            if ports[link, FAST] and ready:
                if not _drain(link, histogram, turn, net, wire):
                    return NOT_PLAIN
            elif ready and not turn[SPIN]:
                other_ready = True
            link += 1
        if other_ready:
            return OTHER_READY
