"""Vehicle time: one timeline from the timestamps inside the frames of all systems.

The first timestamp starts the timeline. Each timestamp belongs to a clock of its system and
component, counting from boot or from the Unix epoch. A clock that agrees with the timeline to
within ten seconds is used unchanged, so that labels and frames show the same numbers; any other is
shifted so that its first timestamp equals the newest time, and again after a reboot. The rule is in
`sender_rules`.
"""

from array import array
from functools import cache

from mavproxy_fault.proxy.sender_rules import MAX_STAMP_US, vehicle_time
from mavproxy_fault.proxy.senders import NEWEST_TIME, T0, UNKNOWN, new_senders
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

STAMP_FIELDS = {"time_usec": 1, "time_boot_ms": 1000, "usec": 1}  # microseconds per count


@cache
def stamp_location(name: str) -> tuple[int, int, int] | None:
    """Return offset, size and microseconds per count of a message's timestamp, if it has one."""
    fields = message_layout(name).fields
    for field, scale in STAMP_FIELDS.items():
        # Microseconds in 32 bits (SERVO_OUTPUT_RAW) wrap every 72 minutes: unusable as a clock.
        if field in fields and not fields[field].extension and fields[field].size * scale >= 8:
            return fields[field].offset, fields[field].size, scale
    return None


def stamp_us(frame: Frame) -> int:
    """Return a frame's timestamp in microseconds; 0 if it is missing or impossible.

    `compiled.frames.stamp` does the same on an array of bytes.
    """
    place = stamp_location(frame.layout.name)
    if place is None:
        return 0
    offset, size, scale = place
    start = frame.payload_at + offset
    end = min(start + size, frame.payload_at + frame.length)
    stamp = int.from_bytes(frame.raw[start:end], "little") * scale
    return stamp if stamp < MAX_STAMP_US else 0


class VehicleClock:
    """The timeline, in the senders array shared with the compiled path."""

    def __init__(self, senders: "array[int] | None" = None) -> None:
        self._senders = new_senders() if senders is None else senders

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
        sender = frame.system << 8 | frame.component
        return vehicle_time(self._senders, sender, stamp_us(frame), now_us)
