"""State of every sender, in one flat array of 64-bit integers.

The core and the compiled path (`compiled`) share the array, so they can alternate at any frame;
`sender_rules` has the rules. A sender is `system << 8 | component`; it has two clocks, one counting
from boot and one from 1970.
"""

from array import array

SENDERS = 1 << 16
UNKNOWN = -(1 << 62)

LINKS = 0  # per sender: bit mask of links it was heard on
NEXT_SEQ = LINKS + SENDERS  # per sender: expected sequence number, UNKNOWN at first
GAPS = NEXT_SEQ + SENDERS  # per sender: frames missing
CLOCK_OFFSET = GAPS + SENDERS  # per clock: vehicle time minus its timestamps, UNKNOWN at first
NEWEST_STAMP = CLOCK_OFFSET + 2 * SENDERS  # per clock: newest timestamp
LAST_HEARD = NEWEST_STAMP + 2 * SENDERS  # per clock: wall time of that timestamp
CANDIDATE_STAMP = LAST_HEARD + 2 * SENDERS  # per clock: unconfirmed timestamp, 0 for none
SYSTEM_LINKS = CANDIDATE_STAMP + 2 * SENDERS  # per system: bit mask of links it was heard on
SYSTEM_TIME = SYSTEM_LINKS + 256  # per system: newest vehicle time, UNKNOWN at first
T0 = SYSTEM_TIME + 256  # first timestamp of all, UNKNOWN at first
NEWEST_TIME = T0 + 1  # newest vehicle time of all
WALL_OFFSET = NEWEST_TIME + 1  # wall time minus link time, at the newest frame
VEHICLE_SYSTEM = WALL_OFFSET + 1  # the system id used in the proxy's own frames
UNCONFIRMED = VEHICLE_SYSTEM + 1  # number of unconfirmed timestamps
SIMULATED = UNCONFIRMED + 1  # 1 from the first HIL_SENSOR: the timeline is the simulator's
LINK_TIME = SIMULATED + 1  # newest link time
LINK_STAMP = LINK_TIME + 1  # vehicle time from which the link time continues
LINK_STAMP_HEARD = LINK_STAMP + 1  # wall time of it
LINK_CLOCK = LINK_STAMP_HEARD + 1  # the clock that it is from
SIZE = LINK_CLOCK + 1


def new_senders() -> "array[int]":
    """Create the initial state, before any sender was heard."""
    unknown = array("q", [UNKNOWN])
    senders = array("q", bytes(8 * SIZE))
    senders[NEXT_SEQ:GAPS] = unknown * SENDERS
    senders[CLOCK_OFFSET:NEWEST_STAMP] = unknown * (2 * SENDERS)
    senders[SYSTEM_TIME:T0] = unknown * 256
    senders[T0] = senders[LINK_STAMP] = UNKNOWN
    senders[VEHICLE_SYSTEM] = 1
    return senders
