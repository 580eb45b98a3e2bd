"""The compiled form's arrays: what each holds and what its columns mean, for both of its sides.

`forwarder` fills the arrays, `frames`, `patches` and `sockets` work on them. Nothing here imports
numba, or numpy, which a proxy without faults need not wait for.
"""

import ctypes
import math
import mmap
import struct
from typing import Any, NamedTuple

from mavproxy_fault.numerics.crc import SLICES, slicing_tables

BATCH = 64  # datagrams per system call
ROW = 65_536  # bytes kept for each
PEERS = 32
NAME = 32  # bytes kept for a socket address
SOCKADDR_IN = 16  # bytes of an IPv4 socket address
HEADER = 8  # 64-bit words of a `mmsghdr`
IDS = 1 << 16
MOST_FRAMES = 256  # in one datagram; what holds more goes the interpreted way
MOST_PLANS = 256
MOST_SEGMENTS = 1024
MOST_DRAWN = 16  # faults that draw from a block of their own
BLOCK = 2048  # numbers drawn ahead for each

# Columns of `table`, by message id
KIND, EXTRA, STAMP_AT, STAMP_SIZE, STAMP_SCALE, TARGET_SYSTEM, TARGET_COMPONENT, PLAN = range(8)
TABLE_SIZE = 8
INTERPRETED, PASS, PASS_UNTIL_EDGE, PLANNED = range(4)  # kinds
# Columns of `plans`, a row per element; the first row of a fault says the rest: whom it is for
# (others are passed by), whose state it knows (others are left to the interpreted way), and where
# the fault that acts next on the message begins
OFFSET, CODE, MODE, SOURCE, ROWS, NEXT, START = range(7)
SYSTEM, COMPONENT, DIRECTION = range(7, 10)
KNOWN_SENDER, KNOWN_WAY, INSTANCE_AT, INSTANCE_SIZE, INSTANCE = range(10, 15)
SEGMENTS_FROM, SEGMENTS_TO, OPEN_LEFT, DRAWS_FROM, WAITS = range(15, 20)  # WAITS: did nothing yet
PLAN_SIZE = 20
ADD, SCALE, REPLACE = range(3)  # modes
NUMBER, GROWS, SEGMENTS, DRAWN = range(4)  # sources: what meets the healthy value
VALUE, LIMIT = range(2)  # columns of `numbers`; LIMIT is `otherwise` where segments are the source
AT_S, FOR_S, AT_START, RATE = range(4)  # columns of `segments`
FRAMES_HIT, SATURATED, USED = range(3)  # columns of `hits`; USED counts draws
STEP, CUT = range(2)  # entries of `outcome`: how far an element moved, whether it saturated
# Columns of `ports`, a row per link
FD, COMPILED, LISTENS, PEER_COUNT, FROM_VEHICLE = range(5)
DATAGRAMS, BYTES, FRAMES, MISSING, FAULTED, SENT, BYTES_SENT, DROPS, ERRORS = range(5, 14)
LONE = 14  # whether to receive one datagram at a time
PORT_SIZE = 15
# Columns of `heads` and `headers`, the words of a `mmsghdr`; of `parts`, those of an `iovec`
NAME_AT, NAME_LENGTH, PARTS_AT, PART_COUNT, _CONTROL, _CONTROL_LENGTH, _FLAGS, LENGTH = range(8)
DATA_AT, DATA_LENGTH = range(2)
# Entries of `loop`
DEADLINE, BASE, SPIN, LINK, AT, COUNT, EDGE, WANTED_AT, POLLS, KEEP = range(10)
RECEIVED_AT, SENT_AT, INDEX_AT, SECONDS, NANOSECONDS, LINK_COUNT, PRECISE = range(10, 17)
DRY, CAME = 17, 23  # whether a block of drawn numbers ran out; when the newest batch came
TIME_AT, POLLS_AT, HEADS_AT, HEADERS_AT, PEERS_AT = range(18, 23)  # addresses, for system calls
DUE_COUNT, DUE_AT = 24, 25  # datagrams to send at one time, kept in the rows after the links'
COMPILED_LINKS = 26  # bit mask
FRAME_COUNT, DRAWS, UNDO_COUNT = range(27, 30)  # of the datagram that is looked at
LENT, MASK = 30, 31  # bytes of a datagram lent in the first row; the links it leaves on
LOOP_SIZE = 32
TIME_IS_UP, HANDED_OVER, OTHER_READY, LOG_FULL, DUE_SENT, LENT_PASSED = range(6)  # why it returns

UNDO_PLACE, UNDO_VALUE = range(2)  # columns of `undo`
CLOCK_CELLS = 7  # entries of `senders` that one frame's time may change

LOG_SIZE = 1 << 24
LOG_MARGIN = 1 << 23  # more than a batch of the smallest frames in the largest datagrams
LATENCY_STEPS = 64 * 8

Integers = Any  # int64, as a memoryview on one side and a numpy array on the other
Words = Any  # uint16
Octets = Any  # uint8
Doubles = Any  # float64


class Shared(NamedTuple):
    """Every array of the compiled form; n is the number of links."""

    loop: Integers  # (LOOP_SIZE,)
    polls: Integers  # (descriptors,) `pollfd` each
    ports: Integers  # (n, PORT_SIZE)
    heads: Integers  # (n + 1, BATCH, HEADER) for recvmmsg
    headers: Integers  # (n + 1, BATCH, HEADER) for sendmmsg
    parts: Integers  # (n + 1, BATCH, 2) what `headers` point to
    names: Octets  # (n + 1, BATCH, NAME) who sent each row
    peers: Octets  # (n, PEERS, NAME)
    heard: Octets  # (n, PEERS) 1 where a peer has spoken since the last count
    histogram: Integers  # (n, LATENCY_STEPS) datagrams by latency
    data: Octets  # ((n + 1) BATCH ROW,) the datagrams' bytes
    senders: Integers  # (senders.SIZE,)
    table: Integers  # (IDS, TABLE_SIZE)
    crc: Words  # (SLICES, 256)
    times: Integers  # (MOST_FRAMES,) vehicle time of each frame of a datagram, microseconds
    undo: Integers  # (MOST_FRAMES CLOCK_CELLS, 2) what `senders` held before this datagram
    received: Octets  # (LOG_SIZE,)
    sent: Octets  # (LOG_SIZE,)
    index: Octets  # (LOG_SIZE,)
    plans: Integers  # (MOST_PLANS, PLAN_SIZE)
    numbers: Doubles  # (MOST_PLANS, 2)
    hits: Integers  # (MOST_PLANS, 3)
    steps: Doubles  # (MOST_PLANS,) largest change by each fault, negative for none
    segments: Doubles  # (MOST_SEGMENTS, 4)
    draws: Doubles  # (MOST_DRAWN BLOCK,)
    outcome: Doubles  # (2,)


ORDER = Shared(*range(len(Shared._fields)))  # where each array's address is given


def table(kind: str, *shape: int) -> Any:
    """Zeroed memory as a view of numbers of one kind; pages cost nothing before they are used."""
    size = struct.calcsize(kind) * math.prod(shape)
    octets: Any = memoryview(mmap.mmap(-1, max(size, 1)))
    return octets[:size].cast(kind, shape)


def address(numbers: Any) -> int:
    """The address of a writable buffer."""
    return ctypes.addressof(ctypes.c_char.from_buffer(numbers))


def new_arrays(links: int, descriptors: int, *, keep: bool) -> dict[str, Any]:
    """The arrays that every proxy needs; with `keep` also those that record the traffic."""
    log = LOG_SIZE if keep else 1
    tables = table("H", SLICES, 256)
    tables.cast("B")[:] = memoryview(slicing_tables()).cast("B")
    return {
        "loop": table("q", LOOP_SIZE),
        "polls": table("q", max(descriptors, 1)),
        "ports": table("q", links, PORT_SIZE),
        "heads": table("q", links + 1, BATCH, HEADER),
        "headers": table("q", links + 1, BATCH, HEADER),
        "parts": table("q", links + 1, BATCH, 2),
        "names": table("B", (links + 1) * BATCH * NAME),
        "peers": table("B", links * PEERS * NAME),
        "heard": table("B", links, PEERS),
        "histogram": table("q", links * LATENCY_STEPS),
        "data": table("B", (links + 1) * BATCH * ROW),
        "table": table("q", IDS, TABLE_SIZE),
        "crc": tables,
        "times": table("q", MOST_FRAMES),
        "undo": table("q", MOST_FRAMES * CLOCK_CELLS, 2),
        "received": table("B", log),
        "sent": table("B", log),
        "index": table("B", log),
        "outcome": table("d", 2),
    }
