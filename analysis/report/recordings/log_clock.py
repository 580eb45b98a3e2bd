"""Put all messages of a log on one time axis: the vehicle's clock, if its messages carry it.

The log's timestamps say when a frame was written: they run at another rate if a run is faster than
real time, and jump when the computer's clock is set. Messages without a time are placed by
interpolation between those with one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.wire.tlog import Columns

AUTOPILOT = 1
BACKWARD_US = 1_000_000  # chosen: smaller steps back are frames out of order
NEAR_US = 5_000_000  # chosen: a message's time within this is of the vehicle's clock


@dataclass(frozen=True, slots=True)
class LogClock:
    """Maps the log's timestamps to the vehicle's time, both in us; empty arrays mean identity.

    `t0_us` is the start of the axis. If the clock is not `continuous`, it was restarted, and the
    times in messages are ambiguous and ignored.
    """

    stamp_us: NDArray[np.float64]
    vehicle_us: NDArray[np.float64]
    t0_us: float
    continuous: bool = True

    def seconds(self, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Times (n,) in s on the axis of the rows (n,) of a message."""
        # First by the log's timestamp, to verify that the message's time is of the vehicle's clock.
        guess = self.at(rows["t_us"])
        own = own_time_us(rows)
        if len(self.stamp_us) == 0 or not self.continuous or own is None or len(own) == 0:
            return guess
        # The median, as single frames may be late.
        if np.median(np.abs((own - self.t0_us) * 1e-6 - guess)) > NEAR_US * 1e-6:
            return guess
        return (own - self.t0_us) * 1e-6

    def at(self, stamp_us: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Times (n,) in s on the axis of the log's timestamps (n,) in microseconds."""
        stamps: NDArray[np.float64] = np.asarray(stamp_us, float)
        if len(self.stamp_us) == 0:
            return np.asarray((stamps - self.t0_us) * 1e-6)
        inside: NDArray[np.float64] = np.interp(stamps, self.stamp_us, self.vehicle_us)
        # Outside the pairs, extrapolate at the rate of the timestamps.
        inside += np.minimum(stamps - self.stamp_us[0], 0) + np.maximum(
            stamps - self.stamp_us[-1], 0
        )
        return np.asarray((inside - self.t0_us) * 1e-6)


def own_time_us(rows: NDArray[np.void]) -> NDArray[np.float64] | None:
    """The times (n,) in the rows of a message, in microseconds; None if it has none."""
    names = rows.dtype.names or ()
    # Boot time first, as `time_usec` may be Unix time in the same log.
    if "time_boot_ms" in names:
        return rows["time_boot_ms"].astype(float) * 1e3
    if "time_usec" in names:
        return rows["time_usec"].astype(float)
    return None


def clock_of(columns: Columns, system: int, t0_us: int | None = None) -> tuple[LogClock, list[str]]:
    """Determine the clock of one vehicle's messages; returns it and notes about clock jumps.

    Parameters
    ----------
    columns : dict of structured arrays
    system : int
        System id of the vehicle.
    t0_us : int, optional
        Vehicle time at which the axis starts; the first message by default.
    """
    stamps, times = _pairs(columns, system)
    first = min((float(rows["t_us"].min()) for rows in columns.values()), default=0.0)
    if len(times) < 2:
        return LogClock(np.empty(0), np.empty(0), first), []
    order = np.argsort(stamps, kind="stable")
    stamps, times = stamps[order], times[order]
    back = np.flatnonzero(np.diff(times) < -BACKWARD_US)
    if len(back) and t0_us is not None:
        # As in the proxy, which wrote the labels: a restarted clock continues from its newest time.
        shifts = np.zeros(len(times))
        shifts[back + 1] = times[back] - times[back + 1]
        times = np.maximum.accumulate(times + np.cumsum(shifts))
        note = f"the vehicle's clock jumps back {len(back)} time(s); the axis and labels continue"
        return LogClock(stamps, times, float(t0_us), continuous=False), [note]
    if len(back):
        note = (
            f"the vehicle's clock jumps back {len(back)} time(s) (restart or joined logs); "
            "times are the log's timestamps"
        )
        return LogClock(np.empty(0), np.empty(0), first), [note]
    # Small steps back are frames out of order, not a clock reset.
    times = np.maximum.accumulate(times)
    clock = LogClock(stamps, times, times[0])
    if t0_us is not None:
        return LogClock(stamps, times, float(t0_us)), []
    earliest = [float(clock.seconds(rows).min()) for rows in columns.values()]
    start = times[0] + min(earliest) * 1e6
    return LogClock(stamps, times, start), []


def _pairs(columns: Columns, system: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Timestamps and times of the messages that certainly carry the vehicle's time."""
    # HIL messages carry the simulator's clock, which faults and labels use.
    names: Sequence[str] = [name for name in columns if name.startswith("HIL_")] or [
        name for name in columns if "time_boot_ms" in (columns[name].dtype.names or ())
    ]
    stamps, times = [np.empty(0)], [np.empty(0)]
    for name in names:
        rows = columns[name]
        rows = rows[rows["system"] == system]
        own = own_time_us(rows)
        if own is not None and (name.startswith("HIL_") or name != "SYSTEM_TIME"):
            # Zero means unknown.
            keep = own > 0
            stamps.append(rows["t_us"][keep].astype(float))
            times.append(own[keep])
    return np.concatenate(stamps), np.concatenate(times)
