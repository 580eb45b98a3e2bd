"""The vehicle's time: one timeline from the stamps inside the frames of all systems.

The first stamp starts the timeline. A stamp belongs to the clock of its system and component, and
counts from boot or from the Unix epoch. Clocks that agree with the timeline to within ten seconds
are taken as they are, so that labels and frames show the same numbers; others are shifted so that
their first stamp falls on the newest time known, and again after a reboot.
"""

from array import array
from functools import cache

from mavproxy_fault.proxy.senders import NEWEST, NOW, SHIFT, SYSTEM_TIME, T0, UNKNOWN, new_memory
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import Frame

STAMP_FIELDS = {"time_usec": 1, "time_boot_ms": 1000, "usec": 1}  # microseconds per count
UNIX_FROM_US = 10**15  # stamps beyond are Unix time (2001 on); no vehicle is up for 31 years
NEAR_US = 10_000_000


@cache
def stamp_place(name: str) -> tuple[int, int, int] | None:
    """Offset and size of a message's stamp, and microseconds per count; None without one."""
    fields = known(name).fields
    for field, scale in STAMP_FIELDS.items():
        if field in fields and not fields[field].extension:
            return fields[field].offset, fields[field].size, scale
    return None


def stamp_us(frame: Frame) -> int:
    """The stamp inside a frame in microseconds; 0 where it has none or says that it is unknown."""
    place = stamp_place(frame.layout.name)
    if place is None:
        return 0
    offset, size, scale = place
    start = frame.payload_at + offset
    end = min(start + size, frame.payload_at + frame.length)
    return int.from_bytes(frame.raw[start:end], "little") * scale


class VehicleClock:
    """The timeline, kept in the memory that the compiled path shares."""

    def __init__(self, memory: "array[int] | None" = None) -> None:
        self._memory = new_memory() if memory is None else memory

    @property
    def t0_us(self) -> int | None:
        """The first stamp of all, None before it."""
        first_us = self._memory[T0]
        return None if first_us == UNKNOWN else first_us

    @property
    def t_us(self) -> int:
        """The newest time."""
        return self._memory[NOW]

    def read(self, frame: Frame, now_us: int) -> int:
        """The time of a frame that came at `now_us` of the wall clock.

        A frame without a stamp takes the newest time of its system, else of any; before the first
        stamp the wall clock serves.
        """
        memory = self._memory
        stamp = stamp_us(frame)
        if stamp == 0:
            latest = memory[SYSTEM_TIME + frame.system]
            if latest != UNKNOWN:
                return latest
            return now_us if memory[T0] == UNKNOWN else memory[NOW]
        if memory[T0] == UNKNOWN:
            memory[T0] = memory[NOW] = stamp
        clock = (frame.system << 8 | frame.component) << 1 | (stamp >= UNIX_FROM_US)
        shift = memory[SHIFT + clock]
        if shift == UNKNOWN:
            shift = 0 if abs(stamp - memory[NOW]) <= NEAR_US else memory[NOW] - stamp
            memory[SHIFT + clock] = shift
        elif stamp < memory[NEWEST + clock] - NEAR_US:
            shift = memory[SHIFT + clock] = memory[NOW] - stamp
        memory[NEWEST + clock] = stamp
        t_us = memory[NOW] = memory[SYSTEM_TIME + frame.system] = stamp + shift
        return t_us
