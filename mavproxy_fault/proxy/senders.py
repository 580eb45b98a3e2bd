"""What the proxy remembers of every sender, as one flat array of 64-bit integers.

The plain path and the compiled one (`compiled`) work on the same memory, so they can take turns at
any frame. A sender is `system << 8 | component`; its clocks are two, counting from boot and from
1970.
"""

from array import array

SENDERS = 1 << 16
UNKNOWN = -(1 << 62)

LINKS = 0  # per sender: bit mask of the links it was heard on
NEXT_SEQ = LINKS + SENDERS  # per sender: the sequence number expected, UNKNOWN at first
GAPS = NEXT_SEQ + SENDERS  # per sender: frames missing
SHIFT = GAPS + SENDERS  # per clock: from its stamps to the timeline, UNKNOWN at first
NEWEST = SHIFT + 2 * SENDERS  # per clock: its newest stamp
SYSTEM_LINKS = NEWEST + 2 * SENDERS  # per system: bit mask of the links it was heard on
SYSTEM_TIME = SYSTEM_LINKS + 256  # per system: its newest time, UNKNOWN at first
T0 = SYSTEM_TIME + 256  # first stamp of all, UNKNOWN at first
NOW = T0 + 1  # newest time of all
LEAD = NOW + 1  # wall time minus vehicle time, by the newest frame
SPEAKER = LEAD + 1  # the system whose name the proxy's own frames carry
SIZE = SPEAKER + 1


def new_memory() -> "array[int]":
    """Nobody heard yet."""
    unknown = array("q", [UNKNOWN])
    memory = array("q", bytes(8 * SIZE))
    memory[NEXT_SEQ:GAPS] = unknown * SENDERS
    memory[SHIFT:NEWEST] = unknown * (2 * SENDERS)
    memory[SYSTEM_TIME:T0] = unknown * 256
    memory[T0] = UNKNOWN
    memory[SPEAKER] = 1
    return memory
