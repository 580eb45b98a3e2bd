"""One time axis for all messages of a log: the vehicle's clock where its messages carry it.

The log's own stamps say when a frame was written: they run at another rate when a run is faster
than real time, and jump when the computer's clock is set. Messages without a time of their own are
placed by interpolating between those that have one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.wire.tlog import Columns

AUTOPILOT = 1
BACKWARD_US = 1_000_000  # steps back smaller than this are frames out of order
NEAR_US = 5_000_000  # a message's time this near the vehicle's clock is that clock


@dataclass(frozen=True, slots=True)
class LogClock:
    """Pairs of the log's stamp and the vehicle's time, microseconds; empty: the stamps themselves.

    `t0_us` is where the axis starts; unless the clock is `continuous`, it was restarted, and a
    message's own time tells nothing.
    """

    stamp_us: NDArray[np.float64]
    vehicle_us: NDArray[np.float64]
    t0_us: float
    continuous: bool = True

    def seconds(self, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Seconds (n,) on the axis of each row (n,) of a message."""
        # By the log's stamp first: that place tells whether the message's own time is the
        # vehicle's.
        guess = self.at(rows["t_us"])
        own = own_time_us(rows)
        if len(self.stamp_us) == 0 or not self.continuous or own is None or len(own) == 0:
            return guess
        # The median: single frames may be late.
        if np.median(np.abs((own - self.t0_us) * 1e-6 - guess)) > NEAR_US * 1e-6:
            return guess
        return (own - self.t0_us) * 1e-6

    def at(self, stamp_us: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Seconds (n,) on the axis of stamps (n,) of the log in microseconds."""
        stamps: NDArray[np.float64] = np.asarray(stamp_us, float)
        if len(self.stamp_us) == 0:
            return np.asarray((stamps - self.t0_us) * 1e-6)
        inside: NDArray[np.float64] = np.interp(stamps, self.stamp_us, self.vehicle_us)
        # Outside the pairs the stamps go on at their own rate.
        inside += np.minimum(stamps - self.stamp_us[0], 0) + np.maximum(
            stamps - self.stamp_us[-1], 0
        )
        return np.asarray((inside - self.t0_us) * 1e-6)


def own_time_us(rows: NDArray[np.void]) -> NDArray[np.float64] | None:
    """The time that each row (n,) of a message carries itself, microseconds; None if none."""
    names = rows.dtype.names or ()
    # Boot time first: `time_usec` may be Unix time in the same log.
    if "time_boot_ms" in names:
        return rows["time_boot_ms"].astype(float) * 1e3
    if "time_usec" in names:
        return rows["time_usec"].astype(float)
    return None


def clock_of(columns: Columns, system: int, t0_us: int | None = None) -> tuple[LogClock, list[str]]:
    """The clock of one vehicle's messages, and what must be said about it.

    Parameters
    ----------
    columns : dict of structured arrays
    system : int
        The vehicle.
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
        # As the proxy counts, whose labels these are: a restarted clock goes on from the newest.
        shifts = np.zeros(len(times))
        shifts[back + 1] = times[back] - times[back + 1]
        times = np.maximum.accumulate(times + np.cumsum(shifts))
        note = (
            f"the vehicle's clock jumps back {len(back)} time(s); labels count on, and so does it"
        )
        return LogClock(stamps, times, float(t0_us), continuous=False), [note]
    if len(back):
        note = (
            f"the vehicle's clock jumps back {len(back)} time(s) (restart or joined logs); "
            "times are the log's own stamps"
        )
        return LogClock(np.empty(0), np.empty(0), first), [note]
    # Small steps back are frames out of order: the clock itself goes on.
    times = np.maximum.accumulate(times)
    clock = LogClock(stamps, times, times[0])
    if t0_us is not None:
        return LogClock(stamps, times, float(t0_us)), []
    earliest = [float(clock.seconds(rows).min()) for rows in columns.values()]
    start = times[0] + min(earliest) * 1e6
    return LogClock(stamps, times, start), []


def _pairs(columns: Columns, system: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stamps and vehicle times of the messages whose time is surely the vehicle's own."""
    # HIL messages carry the simulator's clock, which all faults and labels go by.
    names: Sequence[str] = [name for name in columns if name.startswith("HIL_")] or [
        name for name in columns if "time_boot_ms" in (columns[name].dtype.names or ())
    ]
    stamps, times = [np.empty(0)], [np.empty(0)]
    for name in names:
        rows = columns[name]
        rows = rows[rows["system"] == system]
        own = own_time_us(rows)
        if own is not None and (name.startswith("HIL_") or name != "SYSTEM_TIME"):
            # Zero is "unknown".
            keep = own > 0
            stamps.append(rows["t_us"][keep].astype(float))
            times.append(own[keep])
    return np.concatenate(stamps), np.concatenate(times)
