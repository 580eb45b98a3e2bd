"""The vehicle's time: one timeline from the stamps inside the frames of all systems.

The first stamp starts the timeline. A stamp belongs to the clock of its system and component, and
counts from boot or from the Unix epoch. Clocks that agree with the timeline to within ten seconds
are taken as they are, so that labels and frames show the same numbers; others are shifted so that
their first stamp falls on the newest time known, and again after a reboot. `sender_rules` holds the
rule.
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
    """Offset and size of a message's stamp, and microseconds per count; None without one."""
    fields = message_layout(name).fields
    for field, scale in STAMP_FIELDS.items():
        # Microseconds in 32 bits (SERVO_OUTPUT_RAW) begin anew every 72 minutes: no clock.
        if field in fields and not fields[field].extension and fields[field].size * scale >= 8:
            return fields[field].offset, fields[field].size, scale
    return None


def stamp_us(frame: Frame) -> int:
    """The stamp inside a frame in microseconds; 0 where it has none, or none that can be.

    `compiled.frames.stamp` is the same on an array of bytes.
    """
    place = stamp_location(frame.layout.name)
    if place is None:
        return 0
    offset, size, scale = place
    start = frame.payload_at + offset
    end = min(start + size, frame.payload_at + frame.length)
    found = int.from_bytes(frame.raw[start:end], "little") * scale
    return found if found < MAX_STAMP_US else 0


class VehicleClock:
    """The timeline, kept in the array of senders that the compiled form shares."""

    def __init__(self, senders: "array[int] | None" = None) -> None:
        self._senders = new_senders() if senders is None else senders

    @property
    def t0_us(self) -> int | None:
        """The first stamp of all, None before it."""
        first_us = self._senders[T0]
        return None if first_us == UNKNOWN else first_us

    @property
    def t_us(self) -> int:
        """The newest time."""
        return self._senders[NEWEST_TIME]

    def read(self, frame: Frame, now_us: int) -> int:
        """The time of a frame that came at `now_us` of the wall clock."""
        sender = frame.system << 8 | frame.component
        return vehicle_time(self._senders, sender, stamp_us(frame), now_us)
