"""The compiled form's arrays: what each holds and what its columns mean, for both of its sides.

`forwarder` fills the arrays, `frames`, `chains` and `sockets` work on them. Nothing here imports
numba, or numpy, which a proxy without faults need not wait for.
"""

import ctypes
from typing import Any, NamedTuple

from mavproxy_fault.fault_parts import memory
from mavproxy_fault.numerics.crc import SLICES, slicing_tables
from mavproxy_fault.proxy import delay_queue, senders
from mavproxy_fault.wire.signing import KEY_LENGTH, STREAMS

ROW = 65_536  # bytes of a chunk at most
PEERS = 32
NAME = 32  # bytes kept for a socket address
SEGMENTS = 64  # that one chunk may leave in
OUT_SIZE = 1 << 20  # bytes that one chunk may become
IDS = 1 << 16
MOST_ENTRIES = 256  # active entries of a schedule
MOST_STEPS = 1024  # entries in the chains of all messages
MOST_ELEMENTS = 2048
MOST_NUMBERS = 16_384
MOST_KEYS = 1024  # senders that rules remember
MOST_WORK = 64  # frames that one frame may become
SLOT = delay_queue.SLOT  # bytes kept for each
MOST_CHAIN = 32  # entries that may act on one message
SAMPLES = 1 << 14  # places for senders of sampled messages: two at one would sample every frame
SAMPLED_SIZE = 1 << 20  # bytes for their frames, which are read five times a second

# Columns of `table`, by message id
KIND, EXTRA, STAMP_AT, STAMP_SIZE, STAMP_SCALE, TARGET_SYSTEM, TARGET_COMPONENT = range(7)
INSTANCE_AT, INSTANCE_SIZE, CHAIN = range(7, 10)  # -1 for none
SAMPLED = 10  # whether viewers want one of its frames in each period
TABLE_SIZE = 11
INTERPRETED, PASS, PASS_UNTIL_EDGE, PLANNED = range(4)  # kinds
# Columns of `entries`, a row for each active entry
EFFECT, RULE, START, SYSTEM, COMPONENT, DIRECTION, INSTANCE = range(7)  # -1: any
REMEMBERS, BY_SENDER, SEALED_TOO, ANNOUNCED = range(7, 11)  # ANNOUNCED: whether its label has begun
DRAW_COUNT, DRAW, DRAWS_FROM, CHANCE, CHANCES_FROM = range(11, 16)  # addresses; -1: draws nothing
ON_LINK, UNTIL = 16, 17  # whether it counts in link time; from when on the core has to see a frame
COUNTS_AT = 18  # of `fault_parts.hits`, in memory
LABEL_AT = 19  # when the core has to see a frame for a label
TAKES_BYTES = 20  # whether it acts on frames that another one has damaged
ENTRY_SIZE = 21
# Effects; IDLE: none before UNTIL
VALUES, FLIP, DELAY, COPIES, RENUMBER, CUT, MIX, IDLE = range(8)
# Columns of `steps`, the chains of entries on a message
ENTRY, FROM, TO, NEXT, END, NUMBERS_FROM = range(6)  # END: bytes that the elements need
STEP_SIZE = 6
# Columns of `elements` and of `factors`
OFFSET, BYTES_OF, KIND_OF, NUMBERS_AT = range(4)
UNSIGNED, SIGNED, REAL = range(3)  # kinds
FACTOR, STEP_SCALE = range(2)  # divisors, for the rule and for the label
# Columns of `keys`: whose memory it is, and where
KEY_ENTRY, KEY_WAY, KEY_SENDER, KEY_MESSAGE, KEY_INSTANCE, MEMORY_AT = range(6)
# Columns of `work`, the frames that one frame becomes
LENGTH_OF, LATE_US, ALTERED = range(3)
# What ALTERED says: a new checksum, or other bytes too, or it is no frame any more
RESEALED, CHANGED, DAMAGED = 1, 2, 3
# Columns of `ports`, a row per link
FD, COMPILED, LISTENS, PEER_COUNT, FROM_VEHICLE = range(5)
DATAGRAMS, BYTES, FRAMES, MISSING, FAULTED, SENT, BYTES_SENT, DROPS, ERRORS = range(5, 14)
NAME_SIZE, BAD_SIGNATURES = 14, 15  # bytes of an address, 0 if it is always the same
STREAM, WENT = 16, 17  # whether it is a stream; bytes of the chunk that it has taken
PORT_SIZE = 18
LINKS, BYTES_OUT, DUE_US = range(3)  # columns of `segments`
# Entries of `loop`; HELD: whether a frame of the chunk is delayed
DEADLINE, BASE, SPIN, HELD, POLLS, LINK_COUNT, COMPILED_LINKS, KEEP = range(8)
SECONDS, NANOSECONDS, TIME_AT, POLLS_AT, NAME_LENGTH, NAME_LENGTH_AT = range(8, 14)  # and addresses
# The chunk: its link, when it came, its bytes (LENT while another process's code lends it), how
# many of them have passed, and what became of it
LINK, CAME, LENGTH, LENT, ROW_AT, FOUND = range(14, 20)
# What leaves: bytes, segments, links outside the compiled form, and those of a whole lent chunk
OUT_AT, SEGMENT, OTHERS, MASK = range(20, 24)
RECEIVED_AT, SENT_AT, INDEX_AT = range(24, 27)  # bytes of the logs
ENGINE_DUE = 27  # link time at which the core has frames to release
EDGE, LINK_EDGE = 28, 29  # from when on the core has to see a frame, by vehicle and by link time
WANTED_AT, WANTED_LINK_AT = 30, 31  # time of the newest frame that a fault may want
SIGNING, KEY_COUNT = 32, 33  # what to do with signed frames, a mask of these two; rows of `keys`
KEYED, STRIPPED = 1, 2
SERVED = 34  # datagrams of the link in turn
NEW_LABEL = 35  # whether the frame has begun one
SEPARATE = 36  # links that send datagrams
CRC_EXTRA, SIGNATURE_AT = 37, 38  # of the frame; 0 without a signature
OTHER_AT = 39  # bytes of `other`
RELEASE = 40  # until when delayed frames are to be released, and nothing else done; 0 for none
RESTED = 41  # from when on the clock may be watched for a due frame
TIMED = 42  # vehicle time of the frame; UNKNOWN if that is not noted yet
SHA_INIT, SHA_UPDATE, SHA_FINAL = range(43, 46)  # addresses of OpenSSL's functions, or 0
SAMPLES_AT = 46  # bytes of `sampled`
LOOP_SIZE = 47
UNTOUCHED, BEGUN = -1, -2
# Why it returns
TIME_IS_UP, HANDED_OVER, OTHER_READY, LENT_PASSED, TO_SETTLE = range(5)
# What became of a datagram: all of it passed, its next frame or its rest is handed over, a label
# has begun, no room for output
DONE, FRAME, REST, NEWS, FULL = range(5)

LONGEST = 65_000  # bytes of an outgoing datagram
LOG_SIZE = 1 << 24
OTHER_SIZE = 1 << 20
LATENCY_STEPS = 64 * 8

Integers = Any  # int64, as a memoryview on one side and a numpy array on the other
Words = Any  # uint16
Octets = Any  # uint8
Doubles = Any  # float64


class Shared(NamedTuple):
    """Every array of the compiled form: kind of its numbers (a `struct` code), and shape.

    `links`, `descriptors` and `log` depend on the proxy. For Python, arrays of octets have one
    dimension only, so that they can be sliced.
    """

    loop: Integers = ("q", LOOP_SIZE)
    polls: Integers = ("q", "descriptors")  # `pollfd` each
    ports: Integers = ("q", "links", PORT_SIZE)
    name: Octets = ("B", NAME)  # who sent the chunk
    peers: Octets = ("B", "links", PEERS, NAME)
    heard: Integers = ("q", "links", PEERS)  # 1 where a peer has spoken since the last count
    histogram: Integers = ("q", "links", LATENCY_STEPS)  # datagrams by latency
    data: Octets = ("B", ROW + 8)  # the chunk; it is copied by eights
    senders: Integers = ("q", senders.SIZE)
    table: Integers = ("q", IDS, TABLE_SIZE)
    crc: Words = ("H", SLICES, 256)
    outs: Octets = ("B", OUT_SIZE)  # what leaves of it
    segments: Integers = ("q", SEGMENTS, 3)  # and on which links, in turn
    waiting: Integers = ("q", delay_queue.SIZE)
    delayed: Octets = ("B", delay_queue.MOST * SLOT)  # the frames of `waiting`
    received: Octets = ("B", "log")
    sent: Octets = ("B", "log")
    index: Octets = ("B", "log")
    other: Octets = ("B", OTHER_SIZE)  # what leaves but is no frame, for the log
    entries: Integers = ("q", MOST_ENTRIES, ENTRY_SIZE)
    chances: Doubles = ("d", MOST_ENTRIES)  # probabilities
    steps: Integers = ("q", MOST_STEPS, STEP_SIZE)
    elements: Integers = ("q", MOST_ELEMENTS, 4)
    factors: Doubles = ("d", MOST_ELEMENTS, 2)
    numbers: Doubles = ("d", MOST_NUMBERS)
    keys: Integers = ("q", MOST_KEYS, 6)
    memory: Doubles = ("d", memory.NUMBERS)
    places: Integers = ("q", MOST_CHAIN)  # where each entry of a chain has its memory
    values: Doubles = ("d", SLOT)  # of a frame's elements
    draws: Doubles = ("d", 2 * SLOT)  # random numbers
    work: Octets = ("B", MOST_WORK * SLOT)
    items: Integers = ("q", MOST_WORK, 3)
    samples: Integers = ("q", SAMPLES, 2)  # sender and period of the newest sample
    sampled: Octets = ("B", SAMPLED_SIZE)  # as a log, but with 4 times the vehicle time + the sides
    key: Octets = ("B", KEY_LENGTH)  # of signatures
    sha_state: Octets = ("B", 256)  # OpenSSL's, of which it takes 112
    digest: Octets = ("B", 32)
    streams: Integers = ("q", 2 * STREAMS)  # of `signing.stream_cell`


SHAPES: dict[str, Any] = Shared._field_defaults


def address(numbers: Any) -> int:
    """The address of a writable buffer."""
    return ctypes.addressof(ctypes.c_char.from_buffer(numbers))


def new_shared(links: int, descriptors: int, *, keep: bool, **given: Any) -> Shared:
    """All arrays but the given ones; with `keep` also those that record the traffic."""
    sizes = {
        "links": links, "descriptors": max(descriptors, 1), "log": LOG_SIZE if keep else 1,
    }  # fmt: skip
    given |= {"memory": memory.ARENA}
    made = Shared(
        *(
            given[name]
            if name in given
            else memory.new_table(kind, *(sizes.get(one, one) for one in shape))
            for name, (kind, *shape) in SHAPES.items()
        )
    )
    made.crc.cast("B")[:] = memoryview(slicing_tables()).cast("B")
    return made
