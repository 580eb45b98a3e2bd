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
SHIFT = GAPS + SENDERS  # per clock: from its stamps to the timeline, UNKNOWN at first
NEWEST = SHIFT + 2 * SENDERS  # per clock: its newest stamp
HEARD_AT = NEWEST + 2 * SENDERS  # per clock: wall time at which that came
SUSPECT = HEARD_AT + 2 * SENDERS  # per clock: a stamp that leapt and waits for another, 0 for none
SYSTEM_LINKS = SUSPECT + 2 * SENDERS  # per system: bit mask of the links it was heard on
SYSTEM_TIME = SYSTEM_LINKS + 256  # per system: its newest time, UNKNOWN at first
T0 = SYSTEM_TIME + 256  # first stamp of all, UNKNOWN at first
NOW = T0 + 1  # newest time of all
LEAD = NOW + 1  # wall time minus vehicle time, by the newest frame
SPEAKER = LEAD + 1  # the system whose name the proxy's own frames carry
DOUBTED = SPEAKER + 1  # stamps that leapt and were not followed
SIZE = DOUBTED + 1


def new_senders() -> "array[int]":
    """Nobody heard yet."""
    unknown = array("q", [UNKNOWN])
    senders = array("q", bytes(8 * SIZE))
    senders[NEXT_SEQ:GAPS] = unknown * SENDERS
    senders[SHIFT:NEWEST] = unknown * (2 * SENDERS)
    senders[SYSTEM_TIME:T0] = unknown * 256
    senders[T0] = UNKNOWN
    senders[SPEAKER] = 1
    return senders
