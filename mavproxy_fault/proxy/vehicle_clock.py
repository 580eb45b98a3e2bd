"""Vehicle time: one timeline from the timestamps inside the frames of all systems.

The first timestamp starts the timeline. Each timestamp belongs to a clock of its system and
component, counting from boot or from the Unix epoch. A clock that agrees with the timeline to
within ten seconds is used unchanged, so that labels and frames show the same numbers; any other is
shifted so that its first timestamp equals the newest time, and again after a reboot. The rule is in
`sender_rules`. A simulator's first HIL_SENSOR restarts a timeline that counts otherwise: until
lockstep begins, PX4 stamps with the uptime of its host.
"""

from array import array
from functools import cache

from mavproxy_fault.proxy.sender_rules import UNIX_TIME_FROM_US, read_stamp, vehicle_time
from mavproxy_fault.proxy.senders import (
    CLOCK_OFFSET,
    NEWEST_TIME,
    SIMULATED,
    SYSTEM_LINKS,
    SYSTEM_TIME,
    T0,
    UNKNOWN,
    new_senders,
)
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

HIL_SENSOR = message_layout("HIL_SENSOR").id
STAMP_FIELDS = {"time_usec": 1, "time_boot_ms": 1000, "usec": 1}  # microseconds per count


@cache
def stamp_location(name: str) -> tuple[int, int, int]:
    """Return offset, size and microseconds per count of a message's timestamp; offset -1: none."""
    fields = message_layout(name).fields
    for field, scale in STAMP_FIELDS.items():
        # Microseconds in 32 bits (SERVO_OUTPUT_RAW) wrap every 72 minutes: unusable as a clock.
        if field in fields and not fields[field].extension and fields[field].size * scale >= 8:
            return fields[field].offset, fields[field].size, scale
    return -1, 0, 0


def stamp_us(frame: Frame) -> int:
    """Return a frame's timestamp in microseconds; 0 if it is missing or impossible."""
    place = stamp_location(frame.layout.name)
    return read_stamp(frame.raw, frame.payload_at, frame.length, place)


class VehicleClock:
    """The timeline, in the senders array shared with the compiled path."""

    def __init__(self, senders: "array[int]") -> None:
        self._senders = senders

    @property
    def t0_us(self) -> int | None:
        """The first timestamp of all, None before it."""
        first_us = self._senders[T0]
        return None if first_us == UNKNOWN else first_us

    @property
    def t_us(self) -> int:
        """The newest vehicle time."""
        return self._senders[NEWEST_TIME]

    def read(self, frame: Frame, now_us: int) -> int:
        """Return the vehicle time of a frame received at wall time `now_us`."""
        senders, stamp = self._senders, stamp_us(frame)
        sender = frame.system << 8 | frame.component
        t_us = vehicle_time(senders, sender, stamp, now_us)
        if frame.id == HIL_SENSOR and stamp and not senders[SIMULATED]:
            senders[SIMULATED] = 1
            if t_us != stamp < UNIX_TIME_FROM_US:
                unknown = new_senders()
                for start, end in ((CLOCK_OFFSET, SYSTEM_LINKS), (SYSTEM_TIME, NEWEST_TIME)):
                    senders[start:end] = unknown[start:end]
                t_us = vehicle_time(senders, sender, stamp, now_us)
        return t_us
