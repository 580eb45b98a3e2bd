"""The compiled form's sockets and streams: wait, receive and send, all from within.

System calls are made from compiled code, so a busy stretch never returns to the interpreter. The
structures are those of 64-bit Linux: `pollfd` and `timespec` are one and two 64-bit words.
"""

from typing import Any

from numba import types

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.frames import (
    begin_chunk,
    begin_sending,
    first_due_us,
    pass_chunk,
    release_due,
)
from mavproxy_fault.compiled.kernel import i64, kernel
from mavproxy_fault.compiled.layout import Shared

DONTWAIT = 0x40
MONOTONIC = 1  # clock
# Before a delayed frame the clock is watched for this long, and as many times longer not: a sleep
# ends late by 25 to 60 us, and watching would cost a dense jitter a whole processor.
WAKE_NS, REST = 100_000, 10
LOOK_EVERY = 63  # rounds of a spinning loop between looks at what is no UDP link
LATEST_US = 1 << 52  # in nanoseconds it fits 64 bits
TURN = 64  # datagrams of a link before the next link has its turn
GOES_ON, IS_EMPTY = -1, -2  # what `_serve` found when there is no reason to return

_recvfrom = types.ExternalFunction(
    "recvfrom",
    types.intp(types.intc, types.intp, types.uintp, types.intc, types.intp, types.intp),
)
_sendto = types.ExternalFunction(
    "sendto",
    types.intp(types.intc, types.intp, types.uintp, types.intc, types.intp, types.uintc),
)
_read = types.ExternalFunction("read", types.intp(types.intc, types.intp, types.uintp))
_write = types.ExternalFunction("write", types.intp(types.intc, types.intp, types.uintp))
_ppoll = types.ExternalFunction(
    "ppoll", types.intc(types.intp, types.uintp, types.intp, types.intp)
)
_clock_gettime = types.ExternalFunction("clock_gettime", types.intc(types.intc, types.intp))


@kernel
def _now_ns(loop: k.Integers) -> Any:
    _clock_gettime(MONOTONIC, loop[k.TIME_AT])
    return loop[k.SECONDS] * 1_000_000_000 + loop[k.NANOSECONDS]


@kernel
def _peer(link: int, shared: Shared) -> int:
    """Which known peer of a link the datagram came from, -1 if from none."""
    peers, ports = shared.peers[link], shared.ports
    for peer in range(ports[link, k.PEER_COUNT]):
        same = True
        for n in range(ports[link, k.NAME_SIZE]):
            if shared.name[n] != peers[peer, n]:
                same = False
                break
        if same:
            return peer
    return -1 if ports[link, k.LISTENS] else 0


@kernel
def _send(at: int, length: int, link: int, shared: Shared) -> None:
    """Send a datagram to all peers of a link; what the kernel refuses is dropped."""
    ports, size = shared.ports, shared.ports[link, k.NAME_SIZE]
    peers = ports[link, k.PEER_COUNT] if ports[link, k.LISTENS] else 1
    if peers == 0:
        ports[link, k.DROPS] += 1
    for peer in range(peers):
        name_at = shared.peers.ctypes.data + k.NAME * (k.PEERS * link + peer) if size else 0
        went = _sendto(ports[link, k.FD], at, length, DONTWAIT, name_at, size)
        if went < 0:  # an error of an earlier datagram, now reported: try again
            ports[link, k.ERRORS] += 1
            went = _sendto(ports[link, k.FD], at, length, DONTWAIT, name_at, size)
        if went < 0:
            ports[link, k.DROPS] += 1
        else:
            ports[link, k.SENT] += 1
            ports[link, k.BYTES_SENT] += length


@kernel
def _write_to(at: int, length: int, link: int, shared: Shared) -> None:
    """Write to a stream; what the kernel does not take, and what follows, is left to the core."""
    loop, ports = shared.loop, shared.ports
    went = max(_write(ports[link, k.FD], at, length), 0)
    ports[link, k.WENT] += went
    ports[link, k.BYTES_SENT] += went
    if went == length:
        ports[link, k.SENT] += 1
    else:
        loop[k.OTHERS] |= 1 << link
        loop[k.COMPILED_LINKS] &= ~(1 << link)


@kernel
def _send_segments(shared: Shared) -> None:
    """Send the outgoing segments on the links of the compiled form."""
    loop, ports, at = shared.loop, shared.ports, shared.outs.ctypes.data
    for link in range(loop[k.LINK_COUNT]):
        ports[link, k.WENT] = 0
    for segment in range(loop[k.SEGMENT]):
        links, length = shared.segments[segment, k.LINKS], shared.segments[segment, k.BYTES_OUT]
        for link in range(loop[k.LINK_COUNT]):
            if links & loop[k.COMPILED_LINKS] & 1 << link == 0:
                continue
            if ports[link, k.STREAM]:
                _write_to(at, length, link, shared)
            else:
                _send(at, length, link, shared)
        at += length


@kernel
def _deadline_ns(now_ns: int, shared: Shared) -> int:
    """When to do something else than to receive: the interpreter's time, or a delayed frame's."""
    loop = shared.loop
    ahead_ns = WAKE_NS if now_ns >= loop[k.RESTED] else 0
    due_ns = min(first_due_us(shared), LATEST_US) * 1000 - loop[k.BASE] - ahead_ns
    return i64(min(due_ns, loop[k.DEADLINE]))


@kernel
def _send_due(shared: Shared) -> bool:
    """Watch the clock until a delayed frame is due, and send all that are; False for none."""
    loop = shared.loop
    due_ns = first_due_us(shared) * 1000 - loop[k.BASE]
    begun_ns = now_ns = _now_ns(loop)
    while now_ns < due_ns:
        now_ns = _now_ns(loop)
    loop[k.RESTED] = now_ns + REST * (now_ns - begun_ns)
    begin_sending(loop)
    found = release_due((now_ns + loop[k.BASE]) // 1000, shared)
    _send_segments(shared)
    return bool(found)


@kernel
def _give_back(shared: Shared) -> None:
    """Put what became of a lent chunk in its place, if all of it leaves together at once; MASK are
    then its links, else UNTOUCHED or BEGUN."""
    loop = shared.loop
    loop[k.MASK] = k.BEGUN if loop[k.ROW_AT] else k.UNTOUCHED
    if loop[k.HELD] or loop[k.FOUND] != k.DONE or loop[k.SEGMENT] > 1:
        return
    if loop[k.OUT_AT] == 0 or loop[k.OUT_AT] == loop[k.LENGTH]:
        loop[k.MASK] = shared.segments[0, k.LINKS] if loop[k.SEGMENT] else 0
        for n in range(loop[k.OUT_AT]):
            shared.data[n] = shared.outs[n]


@kernel
def _serve(link: int, shared: Shared) -> int:
    """Pass on a datagram or chunk of a link; the reason to return, or GOES_ON or IS_EMPTY."""
    loop, ports = shared.loop, shared.ports
    started = _now_ns(loop)
    if started >= _deadline_ns(started, shared):  # what is due leaves before it
        return k.TIME_IS_UP
    loop[k.NAME_LENGTH], descriptor, data_at = k.NAME, ports[link, k.FD], shared.data.ctypes.data
    if ports[link, k.STREAM]:
        length = _read(descriptor, data_at, k.ROW)
        if length == 0 or (length < 0 and shared.polls[link] >> 48 != 0):
            ports[link, k.COMPILED] = 0  # it has ended, or another peer comes: for the interpreter
            return k.OTHER_READY
    else:
        length = _recvfrom(
            descriptor, data_at, k.ROW, DONTWAIT, shared.name.ctypes.data, loop[k.NAME_LENGTH_AT]
        )
    if length < 0:
        return IS_EMPTY
    loop[k.LINK], loop[k.CAME] = link, started
    begin_chunk(length, loop)
    ports[link, k.DATAGRAMS] += 1
    ports[link, k.BYTES] += length
    peer = _peer(link, shared)
    if peer >= 0 and length > 0:
        pass_chunk(shared)
        if loop[k.ROW_AT]:
            shared.heard[link, peer] = 1
    if loop[k.FOUND] != k.DONE:
        return k.HANDED_OVER
    _send_segments(shared)
    spent = max(_now_ns(loop) - started, 16)
    octave = i64(0)
    while spent >> octave:
        octave += 1
    shared.histogram[link, octave << 3 | spent >> (octave - 4) & 7] += 1
    return k.TO_SETTLE if loop[k.OTHERS] else GOES_ON


@kernel
def _wait(remaining_ns: int, loop: k.Integers) -> bool:
    """Look at all descriptors, and sleep until one has something; False if a signal came."""
    loop[k.SECONDS] = remaining_ns // 1_000_000_000
    loop[k.NANOSECONDS] = remaining_ns % 1_000_000_000
    return bool(_ppoll(loop[k.POLLS_AT], loop[k.POLLS], loop[k.TIME_AT], 0) >= 0)


@kernel
def _serve_links(look: bool, shared: Shared) -> int:
    """Serve all links that have something; the reason to return, GOES_ON for none."""
    loop, reason = shared.loop, GOES_ON
    for n in range(loop[k.POLLS]):
        ready = look and shared.polls[n] >> 48 != 0
        if n >= loop[k.LINK_COUNT] or not shared.ports[n, k.COMPILED]:
            reason = k.OTHER_READY if ready else reason
            continue
        while (ready or loop[k.SPIN]) and (n != loop[k.LINK] or loop[k.SERVED] < TURN):
            before = loop[k.LINK]
            found = _serve(n, shared)
            if found == IS_EMPTY:
                break
            loop[k.SERVED] = loop[k.SERVED] + 1 if n == before else 1
            if found >= 0:
                return found
            if shared.ports[n, k.STREAM]:  # one chunk, then the others have their turn
                break
    loop[k.SERVED] = 0  # all have had their turn
    return reason


def forward(shared: Shared) -> int:
    """Forward until the deadline, or until something is to be handed over; says which."""
    loop = shared.loop
    if loop[k.LENT]:
        begin_chunk(loop[k.LENT], loop)
        loop[k.LENT] = 0
        pass_chunk(shared)
        _give_back(shared)
        return k.LENT_PASSED
    if loop[k.RELEASE]:
        begin_sending(loop)
        release_due(loop[k.RELEASE], shared)
        loop[k.RELEASE] = 0
        return k.LENT_PASSED
    rounds = i64(0)
    while True:
        now_ns = _now_ns(loop)
        remaining_ns = _deadline_ns(now_ns, shared) - now_ns
        if remaining_ns <= 0:
            if now_ns >= loop[k.DEADLINE] or not _send_due(shared):
                return k.TIME_IS_UP
            if loop[k.OTHERS]:
                return k.TO_SETTLE
            continue
        look = loop[k.SPIN] == 0 or rounds & LOOK_EVERY == 0
        rounds += 1
        if look and not _wait(0 if loop[k.SPIN] else remaining_ns, loop):
            return k.TIME_IS_UP
        reason = _serve_links(look, shared)
        if reason > k.TIME_IS_UP:
            return reason
