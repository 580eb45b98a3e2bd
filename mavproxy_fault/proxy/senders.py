"""What the proxy remembers of every sender, as one flat array of 64-bit integers.

The core and the compiled form (`compiled`) work on the same array, so they can alternate at any
frame; `sender_rules` says how. A sender is `system << 8 | component`; its clocks are two, counting
from boot and from 1970.
"""

from array import array

SENDERS = 1 << 16
UNKNOWN = -(1 << 62)

LINKS = 0  # per sender: bit mask of the links it was heard on
NEXT_SEQ = LINKS + SENDERS  # per sender: the sequence number expected, UNKNOWN at first
GAPS = NEXT_SEQ + SENDERS  # per sender: frames missing
CLOCK_OFFSET = GAPS + SENDERS  # per clock: from its stamps to the timeline, UNKNOWN at first
NEWEST_STAMP = CLOCK_OFFSET + 2 * SENDERS  # per clock: its newest stamp
LAST_HEARD = NEWEST_STAMP + 2 * SENDERS  # per clock: wall time at which that came
CANDIDATE_STAMP = (
    LAST_HEARD + 2 * SENDERS
)  # per clock: a stamp that leapt and waits for another, 0 for none
SYSTEM_LINKS = CANDIDATE_STAMP + 2 * SENDERS  # per system: bit mask of the links it was heard on
SYSTEM_TIME = SYSTEM_LINKS + 256  # per system: its newest time, UNKNOWN at first
T0 = SYSTEM_TIME + 256  # first stamp of all, UNKNOWN at first
NEWEST_TIME = T0 + 1  # newest time of all
WALL_OFFSET = NEWEST_TIME + 1  # wall time minus vehicle time, by the newest frame
VEHICLE_SYSTEM = WALL_OFFSET + 1  # the system whose name the proxy's own frames carry
UNCONFIRMED = VEHICLE_SYSTEM + 1  # stamps that leapt and were not followed
SIZE = UNCONFIRMED + 1


def new_senders() -> "array[int]":
    """Nobody heard yet."""
    unknown = array("q", [UNKNOWN])
    senders = array("q", bytes(8 * SIZE))
    senders[NEXT_SEQ:GAPS] = unknown * SENDERS
    senders[CLOCK_OFFSET:NEWEST_STAMP] = unknown * (2 * SENDERS)
    senders[SYSTEM_TIME:T0] = unknown * 256
    senders[T0] = UNKNOWN
    senders[VEHICLE_SYSTEM] = 1
    return senders
