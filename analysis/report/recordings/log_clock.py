"""Put all messages of a log on one time axis: the vehicle's clock, if its messages carry it.

The log's timestamps say when a frame was written: they run at another rate if a run is faster than
real time, jump when the computer's clock is set, and may be missing. `steady_stamps` removes such
jumps by the vehicle's own times, which distinguish them from a restart of the vehicle; the
timestamps only place one boot after another. Messages without a time are placed between those with
one.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.misdated_stamps import find_misdated, find_restarts
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.tlog import Columns

GROUND_STATION, NO_AUTOPILOT = 6, 8  # MAV_TYPE_GCS; MAV_AUTOPILOT_INVALID: cameras, gimbals
BACKWARD_US = 1_000_000  # chosen: smaller steps back are frames out of order
NEAR_US = 5_000_000  # chosen: a message's time within this is of the vehicle's clock
SET_US = 2_000_000  # chosen: a larger lasting change of the stamps' offset is a clock that was set
LASTING_US = 30_000_000  # chosen: frames that a stalled link delivers late have caught up by then
LATEST_US = 60_000_000  # chosen: no link delivers a frame so late
MOST_PAUSE_US = 86_400_000_000  # one day; chosen: between two boots in one log
LEAST_PAUSE_US = 1_000_000  # between two boots whose pause is unknown
MOST_SETTINGS = 20  # chosen: more of them are bytes that are no timestamps
WALL_US = 1_000_000_000_000_000  # timestamps later than this (2001) are Unix time


class _ClockSetting(NamedTuple):
    """The first frame by another clock, by how much it differs, and the frames with a vehicle's
    time before and behind the change."""

    frame: int
    by_us: int
    first: int
    last: int


@dataclass(slots=True)
class StampState:
    """State of `steady_stamps` between the blocks of a log."""

    shift_us: int = 0
    stamp_us: int | None = None
    vehicle_us: float | None = None
    settings: list[int] = field(default_factory=list)  # by how much, us
    # Corrected stamps of the last frame of a boot and the first frame of the next.
    restarts_us: list[tuple[int, int]] = field(default_factory=list)
    unstamped: bool = False

    def notes(self) -> list[str]:
        """Notes for readers of the report about the log's timestamps."""
        found = []
        if self.unstamped:
            found.append("the log has no timestamps: times are the vehicle's")
        if self.settings:
            far_s = max(self.settings, key=abs) * 1e-6
            found.append(
                f"the clock of the computer that wrote the log was set {len(self.settings)} "
                f"time(s), by up to {far_s:+,.0f} s; the vehicle's clock ran on and counts"
            )
        return found


@dataclass(frozen=True, slots=True)
class LogClock:
    """Maps the log's timestamps to the vehicle's time, both in us; empty arrays mean identity.

    `t0_us` is the start of the axis. If the clock is not `continuous`, it was restarted, and the
    times in messages are ambiguous and ignored. Only messages of `component` carry this clock (-1:
    those of all components).
    """

    stamp_us: NDArray[np.float64]
    vehicle_us: NDArray[np.float64]
    t0_us: float
    continuous: bool = True
    component: int = -1

    def seconds(self, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Times (n,) in s on the axis of the rows (n,) of a message."""
        # First by the log's timestamp, to verify that the message's time is of the vehicle's clock.
        guess = self.at(rows["t_us"])
        own = own_time_us(rows)
        if len(self.stamp_us) == 0 or not self.continuous or own is None or len(own) == 0:
            return guess
        on_axis = (own - self.t0_us) * 1e-6
        mine = np.ones(len(rows), bool)
        if self.component >= 0:
            mine = rows["component"] == self.component
        # The median, as single frames may be late.
        if not mine.any() or np.median(np.abs(on_axis - guess)[mine]) > NEAR_US * 1e-6:
            return guess
        return np.where(mine, on_axis, guess)

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


def autopilot_component(columns: Columns, system: int | None = None) -> int:
    """Component id of the autopilot, by its heartbeats; -1 if there are none."""
    beats = columns.get("HEARTBEAT")
    if beats is None:
        return -1
    beats = beats[(beats["type"] != GROUND_STATION) & (beats["autopilot"] != NO_AUTOPILOT)]
    own = beats["component"] if system is None else beats["component"][beats["system"] == system]
    return int(np.bincount(own).argmax()) if len(own) else -1


def steady_stamps(frames: NDArray[np.void], columns: Columns, state: StampState) -> None:
    """Remove jumps of the log's clock from the timestamps of a log or of the next block of it.

    Parameters
    ----------
    frames : structured array, shape (n,)
        As `mavproxy_fault.wire.tlog.Log.frames`; `t_us` is changed in place.
    columns : dict of structured arrays
        Of the same frames; `t_us` is changed in place.
    state : StampState
        Carried from block to block; changed.
    """
    at, vehicle_us = _timed_frames(frames, columns)
    before, newest_us = state.vehicle_us, state.stamp_us or 0
    stamps = frames["t_us"].astype(np.int64)
    # Bytes that are no timestamps: a frame counts as of the one before.
    sound = np.maximum.accumulate(np.where(find_misdated(stamps), 0, np.arange(len(stamps))))
    stamps = stamps[sound]
    settings = []
    # Bytes that are no stamps: a log of frames alone, with foreign bytes between them.
    for runs in (_unstamped_runs(stamps, at, vehicle_us), [(0, len(stamps))]):
        for begin, end in runs if len(at) > 1 else ():
            stamps[begin:end] = _stamps_by_vehicle(begin, end, at, vehicle_us)
            state.unstamped = True
        settings = _clock_settings(stamps, at, vehicle_us, state)
        wild = np.abs(np.diff(stamps[at] - vehicle_us)) > SET_US
        if np.count_nonzero(wild) <= max(MOST_SETTINGS, len(at) // MOST_SETTINGS):
            break
    shifts = np.zeros(len(stamps), np.int64)
    for jump in settings:
        shifts[jump.frame] -= jump.by_us
        state.settings.append(jump.by_us)
    stamps = stamps + state.shift_us + np.cumsum(shifts)
    for jump in settings:
        # Frames beside the jump may have kept the old clock.
        between = slice(jump.first + 1, jump.last)
        stamps[between] = np.clip(stamps[between], stamps[jump.first], stamps[jump.last])
    if state.stamp_us is None and stamps.size and frames["t_us"][0] < WALL_US:
        # A log that begins before the computer knew the date gets the later timestamps.
        right = frames["t_us"] - stamps
        stamps = stamps + (right[-1] if frames["t_us"][-1] >= WALL_US else 0)
    if len(stamps):
        state.shift_us = int(stamps[-1] - frames["t_us"][-1])
        state.stamp_us = int(stamps[-1])
        state.vehicle_us = float(vehicle_us[-1]) if len(at) else None
    for i in find_restarts(vehicle_us).tolist():
        state.restarts_us.append((int(stamps[at[i - 1]]), int(stamps[at[i]])))
    if len(at) and before is not None and vehicle_us[0] < before - BACKWARD_US:
        state.restarts_us.append((newest_us, int(stamps[at[0]])))
    frames["t_us"] = stamps
    for name, rows in columns.items():
        rows["t_us"] = stamps[_places(frames, name)]


def _places(frames: NDArray[np.void], name: str) -> NDArray[np.int64]:
    """The places (n,) of a message's rows among the frames."""
    return np.flatnonzero((frames["id"] == message_layout(name).id) & frames["known"])


def _timed_frames(
    frames: NDArray[np.void], columns: Columns
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Places (m,) and times since boot (m,) of the frames of one autopilot, in the log's order."""
    component = autopilot_component(columns)
    places, times, senders = [np.empty(0, np.int64)], [np.empty(0)], [np.empty(0, np.int64)]
    for name, rows in columns.items():
        if "time_boot_ms" in (rows.dtype.names or ()) and name != "SYSTEM_TIME":
            own = rows["time_boot_ms"] > 0
            own &= (rows["component"] == component) | (component < 0)
            places.append(_places(frames, name)[own])
            times.append(rows["time_boot_ms"][own] * 1e3)
            senders.append(rows["system"][own].astype(np.int64) << 8 | rows["component"][own])
    at, vehicle_us, sender = np.concatenate(places), np.concatenate(times), np.concatenate(senders)
    if len(at) == 0:
        return at, vehicle_us
    # Each vehicle and component has a clock of its own: use that of the one which sends most.
    most = sender == np.bincount(sender).argmax()
    order = np.argsort(at[most], kind="stable")
    at, vehicle_us = at[most][order], vehicle_us[most][order]
    sound = ~find_misdated(vehicle_us.astype(np.int64))
    return at[sound], vehicle_us[sound]


def _unstamped_runs(
    stamps: NDArray[np.int64], at: NDArray[np.int64], vehicle_us: NDArray[np.float64]
) -> list[tuple[int, int]]:
    """Runs (first frame, end) of equal timestamps while the vehicle's time goes on."""
    edges = np.flatnonzero(np.diff(stamps)) + 1
    begins, ends = np.append(0, edges), np.append(edges, len(stamps))
    first = np.searchsorted(at, begins)
    last = np.searchsorted(at, ends) - 1
    some = last > first
    begins, ends, first, last = begins[some], ends[some], first[some], last[some]
    long = np.abs(vehicle_us[last] - vehicle_us[first]) > SET_US
    # Frames that a stalled link delivered together: the newest one is in time.
    offsets = stamps[at] - vehicle_us
    for beside, own in ((first - 1, last), (last + 1, last)):
        there = (beside >= 0) & (beside < len(at))
        near = np.clip(beside, 0, len(at) - 1)
        long &= ~there | (np.abs(offsets[near] - offsets[own]) > SET_US)
    return list(zip(begins[long].tolist(), ends[long].tolist(), strict=True))


def _stamps_by_vehicle(
    begin: int, end: int, at: NDArray[np.int64], vehicle_us: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Timestamps of the frames from `begin` to `end` from the vehicle's times alone; boots follow
    each other."""
    inside = (at >= begin) & (at < end)
    places, own = at[inside], vehicle_us[inside]
    steps = np.diff(own, prepend=own[0])
    steps[find_restarts(own)] = LEAST_PAUSE_US
    timeline = np.maximum.accumulate(own[0] + np.cumsum(steps))
    return np.interp(np.arange(begin, end), places, timeline).astype(np.int64)


def _clock_settings(
    stamps: NDArray[np.int64],
    at: NDArray[np.int64],
    vehicle_us: NDArray[np.float64],
    state: StampState,
) -> list[_ClockSetting]:
    """Every setting of the log's clock."""
    found: list[_ClockSetting] = []
    if len(at) == 0:
        # Without the vehicle's time only steps back, or of days, are certain.
        steps = np.diff(stamps)
        jumps = np.flatnonzero((steps < -BACKWARD_US) | (steps > MOST_PAUSE_US)) + 1
        return [_ClockSetting(i, int(stamps[i] - stamps[i - 1]), i - 1, i) for i in jumps.tolist()]
    if state.stamp_us is not None and state.vehicle_us is not None:
        since_us = int(stamps[0]) + state.shift_us - state.stamp_us
        steps_us = since_us - round(vehicle_us[0] - state.vehicle_us)
        restarted = vehicle_us[0] < state.vehicle_us - BACKWARD_US
        wrong = not 0 <= since_us <= MOST_PAUSE_US if restarted else abs(steps_us) > SET_US
        if wrong:
            found.append(_ClockSetting(0, since_us if restarted else steps_us, 0, 0))
    restarts = set(find_restarts(vehicle_us).tolist())
    # Single late frames keep the time of the newest before them.
    times = np.maximum.accumulate(_continued(vehicle_us, sorted(restarts)))
    offsets = stamps[at] - times
    for i in np.flatnonzero(np.abs(np.diff(offsets)) > SET_US).tolist():
        j = i + 1
        first, last = int(at[i]), int(at[j])
        # The stamps jump at one of the frames between two that carry a time.
        jump = first + 1 + int(np.abs(np.diff(stamps[first : last + 1])).argmax())
        if j in restarts:
            pause = int(stamps[last] - stamps[first])
            if not 0 <= pause <= MOST_PAUSE_US:
                found.append(_ClockSetting(jump, pause - LEAST_PAUSE_US, first, last))
            continue
        before = np.searchsorted(times, times[i] - LASTING_US)
        behind = np.searchsorted(times, times[j] + LASTING_US, "right")
        change = float(offsets[j] - offsets[i])
        # A stalled link delivers its frames late, and then catches up.
        if abs(change) <= LATEST_US:
            lasting = float(np.median(offsets[j:behind]) - np.median(offsets[before:j]))
        else:
            lasting = change
        if abs(lasting) > SET_US and abs(lasting) > abs(change) / 2:
            found.append(_ClockSetting(jump, round(change), first, last))
    return found


def _continued(vehicle_us: NDArray[np.float64], restarts: list[int]) -> NDArray[np.float64]:
    """The vehicle's times (m,), each boot continued from the newest time of the one before."""
    times = vehicle_us.copy()
    for i in restarts:
        times[i:] = vehicle_us[i:] + (times[:i].max() - vehicle_us[i])
    return times


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
    component, stamps, times = _pairs(columns, system)
    first = min((float(rows["t_us"].min()) for rows in columns.values()), default=0.0)
    if len(times) < 2:
        return LogClock(np.empty(0), np.empty(0), first), []
    order = np.argsort(stamps, kind="stable")
    stamps, times = stamps[order], times[order]
    sound = ~find_misdated(times.astype(np.int64))
    stamps, times = stamps[sound], times[sound]
    back = find_restarts(times)
    if len(back) and t0_us is not None:
        # As in the proxy, which wrote the labels: a restarted clock continues from its newest time.
        times = np.maximum.accumulate(_continued(times, back.tolist()))
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
    clock = LogClock(stamps, times, times[0], component=component)
    if t0_us is not None:
        return LogClock(stamps, times, float(t0_us), component=component), []
    earliest = [float(clock.seconds(rows).min()) for rows in columns.values()]
    start = times[0] + min(earliest) * 1e6
    return LogClock(stamps, times, start, component=component), []


def _pairs(columns: Columns, system: int) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
    """Component, and timestamps and times of the messages that certainly carry its time."""
    # HIL messages carry the simulator's clock, which faults and labels use.
    simulated = [name for name in columns if name.startswith("HIL_")]
    timed = [name for name in columns if "time_boot_ms" in (columns[name].dtype.names or ())]
    component = -1 if simulated else autopilot_component(columns, system)
    stamps, times = [np.empty(0)], [np.empty(0)]
    for name in simulated or timed:
        rows = columns[name]
        rows = rows[rows["system"] == system]
        # A companion has a clock of its own.
        rows = rows if component < 0 else rows[rows["component"] == component]
        own = own_time_us(rows)
        if own is not None and name != "SYSTEM_TIME":
            # Zero means unknown.
            keep = own > 0
            stamps.append(rows["t_us"][keep].astype(float))
            times.append(own[keep])
    return component, np.concatenate(stamps), np.concatenate(times)
