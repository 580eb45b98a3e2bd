"""The vehicle's time of the messages of a tlog.

Messages with the vehicle's time show its clock; the log's own (steady) timestamps place what has
no time, or that of another component, and one boot after another.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.log_stamps import autopilot_component
from analysis.recordings.flight_logs.log_time import STALE_US, RowClock, join_clocks
from mavproxy_fault.wire.tlog import Columns

NEAR_US = 5_000_000  # chosen: a message's time within this is of the vehicle's clock
SECOND = np.array([0, 1_000_000])


@dataclass(frozen=True, slots=True)
class LogClock:
    """Maps a log's timestamps, and the times in the messages of `component` (-1: of all), to the
    axis that starts at `t0_us`."""

    clock: RowClock
    t0_us: int
    component: int = -1

    def seconds(self, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Times (n,) in s on the axis of the rows (n,) of a message."""
        # First by the log's timestamp, to verify that the message's time is of the vehicle's clock.
        guess, own = self.clock.between(rows["t_us"]), own_time_us(rows)
        if own is not None and len(own):
            mine = (rows["component"] == self.component) | (self.component < 0)
            mine &= own > 0
            own = self.clock.continued(rows["t_us"], own)
            # The first samples that an autopilot sends may be from long before the log.
            mine &= own >= self.clock.t_us[0] - STALE_US
            # The median, as single frames may be late.
            if mine.any() and np.median(np.abs(own - guess)[mine]) <= NEAR_US:
                guess = np.where(mine, own, guess)
        return np.asarray((guess - self.t0_us) * 1e-6)

    def at(self, stamp_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Times (n,) in s on the axis of the log's timestamps (n,) in microseconds."""
        return np.asarray((self.clock.between(stamp_us) - self.t0_us) * 1e-6)


def own_time_us(rows: NDArray[np.void]) -> NDArray[np.int64] | None:
    """The times (n,) in the rows of a message, in microseconds; None if it has none."""
    names = rows.dtype.names or ()
    # Boot time first, as `time_usec` may be Unix time in the same log.
    if "time_boot_ms" in names:
        return rows["time_boot_ms"].astype(np.int64) * 1000
    return rows["time_usec"].astype(np.int64) if "time_usec" in names else None


def clock_of(columns: Columns, t0_us: int | None = None) -> tuple[LogClock, list[str]]:
    """Determine the clock of one vehicle's messages; returns it and notes about restarts.

    `t0_us` is the vehicle's time at which the axis starts; the first message by default.
    """
    # HIL messages carry the simulator's clock, which faults and labels use.
    simulated = [name for name in columns if name.startswith("HIL_")]
    timed = [name for name in columns if "time_boot_ms" in (columns[name].dtype.names or ())]
    component = -1 if simulated else autopilot_component(columns)
    parts = []
    for name in simulated or timed:
        # A companion has a clock of its own.
        rows = columns[name]
        rows = rows[(rows["component"] == component) | (component < 0)]
        own = own_time_us(rows)
        if own is not None and name != "SYSTEM_TIME":
            # Zero means unknown.
            parts.append((rows["t_us"][own > 0], own[own > 0]))
    # With labels as in the proxy, which wrote them: a restarted clock goes on at once.
    clock = join_clocks(parts, None, None if t0_us is None else 0)
    if len(clock.at) < 2:
        # Without the vehicle's time the log's counts.
        clock = clock._replace(at=SECOND, t_us=SECOND, shifts=clock.shifts[:1] * 0)
    notes = [f"the vehicle restarted {clock.restarts} time(s) in this log: its boots follow one "
             "another as the log's timestamps say"] if clock.restarts else []  # fmt: skip
    found = LogClock(clock, t0_us or 0, component)
    if t0_us is None:
        starts = [found.seconds(rows).min() for rows in columns.values() if len(rows)]
        found = LogClock(clock, round(min(starts, default=0.0) * 1e6), component)
    return found, notes
