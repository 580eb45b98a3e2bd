"""The compiled path's tables: what the columns of its arrays mean, for both of its sides.

`forwarder` fills the arrays, `frames` and `sockets` work on them. Nothing here imports numba, or
numpy, which a proxy without faults need not wait for.
"""

import ctypes
import math
import mmap
import struct
from typing import Any

from fastcrc.crc16 import mcrf4xx

BATCH = 64  # datagrams per system call
ROW = 65_536  # bytes kept for each
PEERS = 32
NAME = 32  # bytes kept for a socket address
SOCKADDR_IN = 16  # bytes of an IPv4 socket address
IDS = 1 << 16
MOST_PLANS = 256
MOST_PIECES = 1024
MOST_DRAWN = 16  # faults that draw from a block of their own
BLOCK = 2048  # numbers drawn ahead for each

# Columns of `table`, by message id
KIND, EXTRA, STAMP_AT, STAMP_SIZE, STAMP_SCALE, TARGET_SYSTEM, TARGET_COMPONENT, PLAN = range(8)
PLAIN, PASS, PASS_UNTIL_EDGE, PLANNED = range(4)  # kinds
# Columns of `plans`, a row per element; the first row of a fault says the rest: whom it is for
# (others are passed by), whose state it knows (others are left to the plain path), and where the
# fault that acts next on the message begins
OFFSET, CODE, MODE, SOURCE, ROWS, NEXT, START = range(7)
SYSTEM, COMPONENT, DIRECTION = range(7, 10)
KNOWN_SENDER, KNOWN_WAY, INSTANCE_AT, INSTANCE_SIZE, INSTANCE = range(10, 15)
PIECES_FROM, PIECES_TO, OPEN_LEFT, DRAWS_FROM, WAITS = range(15, 20)  # WAITS: did nothing yet
PLAN_SIZE = 20
ADD, SCALE, REPLACE = range(3)  # modes
NUMBER, GROWS, PIECES, DRAWN = range(4)  # sources: what meets the healthy value
VALUE, LIMIT = range(2)  # columns of `numbers`; LIMIT is `otherwise` where pieces are the source
FRAMES_HIT, SATURATED, LAST, USED = range(4)  # columns of `hits`; USED counts draws
# Columns of `ports`, a row per link
FD, FAST, LISTENS, PEER_COUNT, FROM_VEHICLE = range(5)
DATAGRAMS, BYTES, FRAMES, MISSING, FAULTED, SENT, BYTES_SENT, DROPS, ERRORS = range(5, 14)
LONE = 14  # whether one datagram at a time is asked for
PORT_SIZE = 15
# Entries of `turn`
DEADLINE, BASE, SPIN, LINK, AT, COUNT, EDGE, WANTED_AT, POLLS, KEEP = range(10)
RECEIVED_AT, SENT_AT, INDEX_AT, SECONDS, NANOSECONDS, LINK_COUNT, PRECISE = range(10, 17)
DRY, CAME = 17, 23  # whether a block of drawn numbers ran out; when the newest batch came
TIME_AT, POLLS_AT, HEADS_AT, HEADERS_AT, PEERS_AT = range(18, 23)  # addresses, for system calls
DUE_COUNT, DUE_AT = 24, 25  # datagrams to send at one time, kept in the rows after the links'
TURN_SIZE = 26
TIME_IS_UP, NOT_PLAIN, OTHER_READY, LOG_FULL, DUE_SENT = range(5)  # why it returns

LOG_SIZE = 1 << 24
LOG_MARGIN = 1 << 23  # more than a batch of the smallest frames in the largest datagrams
LATENCY_STEPS = 64 * 8


def table(kind: str, *shape: int) -> Any:
    """Zeroed memory as a view of numbers of one kind; pages cost nothing before they are used."""
    size = struct.calcsize(kind) * math.prod(shape)
    plain: Any = memoryview(mmap.mmap(-1, max(size, 1)))
    return plain[:size].cast(kind, shape)


def address(memory: Any) -> int:
    """Where a writable buffer lies."""
    return ctypes.addressof(ctypes.c_char.from_buffer(memory))


def crc_tables() -> Any:
    """Slicing tables, shape (8, 256): entry [n, b] is the CRC of byte b followed by n zeros."""
    tables = table("H", 8, 256)
    for byte in range(256):
        tables[0, byte] = mcrf4xx(bytes((byte,)), 0)
    for n in range(1, 8):
        for byte in range(256):
            crc = tables[n - 1, byte]
            tables[n, byte] = crc >> 8 ^ tables[0, crc & 0xFF]
    return tables
