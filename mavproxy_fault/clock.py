"""The vehicle's time: one timeline from the stamps inside the frames of all systems.

The first stamp starts the timeline. A stamp belongs to the clock of its system and component, and
counts from boot or from the Unix epoch. Clocks that agree with the timeline to within ten seconds
are taken as they are, so that labels and frames show the same numbers; others are shifted so that
their first stamp falls on the newest time known, and again after a reboot.
"""

from functools import cache

from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import Frame

STAMP_FIELDS = {"time_usec": 1, "time_boot_ms": 1000, "usec": 1}  # microseconds per count
UNIX_FROM_US = 10**15  # stamps beyond are Unix time (2001 on); no vehicle is up for 31 years
NEAR_US = 10_000_000


@cache
def _stamp_place(name: str) -> tuple[int, int, int] | None:
    fields = known(name).fields
    for field, scale in STAMP_FIELDS.items():
        if field in fields and not fields[field].extension:
            return fields[field].offset, fields[field].size, scale
    return None


def stamp_us(frame: Frame) -> int:
    """The stamp inside a frame in microseconds; 0 where it has none or says that it is unknown."""
    place = _stamp_place(frame.layout.name)
    if place is None:
        return 0
    offset, size, scale = place
    start = frame.payload_at + offset
    end = min(start + size, frame.payload_at + frame.length)
    return int.from_bytes(frame.raw[start:end], "little") * scale


class VehicleClock:
    """The timeline; `t0_us` is its first stamp and `t_us` its newest."""

    def __init__(self) -> None:
        self.t0_us: int | None = None
        self.t_us = 0
        self._shifts: dict[tuple[int, int, bool], int] = {}
        self._newest: dict[tuple[int, int, bool], int] = {}
        self._systems: dict[int, int] = {}

    def read(self, frame: Frame, now_us: int) -> int:
        """The time of a frame that came at `now_us` of the wall clock.

        A frame without a stamp takes the newest time of its system, else of any; before the first
        stamp the wall clock serves.
        """
        stamp = stamp_us(frame)
        if stamp == 0:
            return self._systems.get(frame.system, now_us if self.t0_us is None else self.t_us)
        if self.t0_us is None:
            self.t0_us = self.t_us = stamp
        clock = (frame.system, frame.component, stamp >= UNIX_FROM_US)
        shift = self._shifts.get(clock)
        if shift is None:
            shift = 0 if abs(stamp - self.t_us) <= NEAR_US else self.t_us - stamp
            self._shifts[clock] = shift
        elif stamp < self._newest[clock] - NEAR_US:
            shift = self._shifts[clock] = self.t_us - stamp
        self._newest[clock] = stamp
        self.t_us = self._systems[frame.system] = stamp + shift
        return self.t_us
