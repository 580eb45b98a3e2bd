"""Make the timestamps of a tlog steady: those of the computer that wrote it.

They run at another rate if a run is faster than real time, jump when the computer's clock is set,
and may be missing. The times since boot in the messages distinguish such jumps from a restart of
the vehicle and from a link that stalls, so that a silence of the link is one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.log_time import LONGEST_GAP_US, PAUSE_US
from analysis.recordings.flight_logs.misdated_stamps import find_misdated, find_restarts
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.tlog import Columns, row_dtype

GROUND_STATION, NO_AUTOPILOT = 6, 8  # MAV_TYPE_GCS; MAV_AUTOPILOT_INVALID: cameras, gimbals
NO_BEATS = np.empty(0, row_dtype("HEARTBEAT"))
SET_US = 2_000_000  # chosen: a larger lasting change of the stamps' offset is a clock that was set
LASTING_US = 30_000_000  # chosen: frames that a stalled link delivers late have caught up by then
LATEST_US = 60_000_000  # chosen: no link delivers a frame so late
MOST_SETTINGS = 20  # chosen: more of them are bytes that are no timestamps
WALL_US = 1_000_000_000_000_000  # timestamps later than this (2001) are Unix time


class TimedFrames(NamedTuple):
    """Places (m,) among the frames of those with a time, and the vehicle's times (m,), in us."""

    at: NDArray[np.int64]
    vehicle_us: NDArray[np.float64]


@dataclass(slots=True)
class StampState:
    """State of `steady_stamps` between the blocks of a log."""

    shift_us: int = 0
    # Steady stamp and vehicle's time of the last frame that has one.
    last: tuple[int, float] | None = None
    begun: bool = False
    settings: list[int] = field(default_factory=list)  # by how much, us
    # Steady stamps of the last frame of a boot and the first frame of the next.
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


def autopilot_beats(columns: Columns) -> NDArray[np.void]:
    """The heartbeats of autopilots: not of ground stations, cameras or gimbals."""
    beats = columns.get("HEARTBEAT", NO_BEATS)
    own = (beats["type"] != GROUND_STATION) & (beats["autopilot"] != NO_AUTOPILOT)
    return np.asarray(beats[own])


def autopilot_component(columns: Columns) -> int:
    """Component id of the autopilot, by its heartbeats; -1 if there are none."""
    beats = autopilot_beats(columns)
    return int(np.bincount(beats["component"]).argmax()) if len(beats) else -1


def steady_stamps(frames: NDArray[np.void], columns: Columns, state: StampState) -> None:
    """Remove jumps of the log's clock from the timestamps of a log or of the next block of it.

    `t_us` of the `frames` (n,), which are as `mavproxy_fault.wire.tlog.Log.frames`, and of the
    columns of the same frames is changed in place; so is `state`, carried from block to block.
    """
    if not len(frames):
        return
    stamps = frames["t_us"].astype(np.int64)
    # Bytes that are no timestamps: a frame counts as of the one before.
    sound = np.where(find_misdated(stamps), 0, np.arange(len(stamps)))
    stamps = stamps[np.maximum.accumulate(sound)]
    places = {name: _places(frames, name) for name in columns}
    timed = _timed_frames(columns, places)
    carried = int(state.last is not None)
    if state.last is not None:
        # The last frame of the block before is the first one of this block.
        stamps = np.append(state.last[0] - state.shift_us, stamps)
        at = np.append(0, timed.at + 1)
        timed = TimedFrames(at, np.append(state.last[1], timed.vehicle_us))
    steady = _without_settings(stamps, timed, state) + state.shift_us
    if not state.begun and frames["t_us"][0] < WALL_US <= frames["t_us"][-1]:
        # A log that begins before the computer knew the date gets the later timestamps.
        steady += frames["t_us"][-1] - steady[-1]
    for i in find_restarts(timed.vehicle_us).tolist():
        state.restarts_us.append((int(steady[timed.at[i - 1]]), int(steady[timed.at[i]])))
    state.begun, state.shift_us = True, int(steady[-1] - frames["t_us"][-1])
    if len(timed.at):
        state.last = int(steady[timed.at[-1]]), float(timed.vehicle_us[-1])
    frames["t_us"] = steady[carried:]
    for name, rows in columns.items():
        rows["t_us"] = frames["t_us"][places[name]]


def _places(frames: NDArray[np.void], name: str) -> NDArray[np.int64]:
    """The places (n,) of a message's rows among the frames."""
    return np.flatnonzero((frames["id"] == message_layout(name).id) & frames["known"])


def _timed_frames(columns: Columns, places: Mapping[str, NDArray[np.int64]]) -> TimedFrames:
    """The frames with a time since boot of one autopilot, in the log's order."""
    component = autopilot_component(columns)
    found = [np.empty((3, 0))]
    for name, rows in columns.items():
        if "time_boot_ms" in (rows.dtype.names or ()) and name != "SYSTEM_TIME":
            own = rows["time_boot_ms"] > 0
            own &= (rows["component"] == component) | (component < 0)
            sender = rows["system"].astype(float) * 256 + rows["component"]
            found.append(np.array([places[name], rows["time_boot_ms"] * 1e3, sender])[:, own])
    at, vehicle_us, sender = np.concatenate(found, axis=1)
    if len(at):
        # Each vehicle and component has a clock of its own: use that of the one that sends most.
        most = sender == np.bincount(sender.astype(np.int64)).argmax()
        order = np.flatnonzero(most)[np.argsort(at[most])]
        order = order[~find_misdated(vehicle_us[order].astype(np.int64))]
        at, vehicle_us = at[order], vehicle_us[order]
    return TimedFrames(at.astype(np.int64), vehicle_us)


def _without_settings(
    stamps: NDArray[np.int64], timed: TimedFrames, state: StampState
) -> NDArray[np.int64]:
    """Stamps (n,) without the settings of the clock: the vehicle's times, and how late each frame
    was received."""
    at, vehicle_us = timed
    # Without the vehicle's time only steps back, or of days, are certain.
    steps = np.diff(stamps, prepend=stamps[:1])
    wrong = (steps < -PAUSE_US) | (steps > LONGEST_GAP_US)
    plain: NDArray[np.int64] = stamps - np.cumsum(np.where(wrong, steps, 0))
    if len(at) < 2:
        state.settings += steps[wrong].tolist()
        return plain
    times = vehicle_us.copy()
    for i in find_restarts(vehicle_us).tolist():
        pause = stamps[at[i]] - stamps[at[i - 1]]
        pause = pause if 0 <= pause <= LONGEST_GAP_US else PAUSE_US
        times[i:] = vehicle_us[i:] + (times[:i].max() + pause - vehicle_us[i])
    times = np.maximum.accumulate(times)
    offsets = stamps[at] - times
    usual = _without_delays(offsets, times)
    usual = np.where(offsets - usual < LATEST_US, usual, offsets)
    changes = np.diff(usual)
    settings = np.round(changes[np.abs(changes) > SET_US]).astype(np.int64)
    if len(settings) > MOST_SETTINGS or np.ptp(stamps) < SET_US < np.ptp(times):
        state.unstamped = True
    else:
        state.settings += settings.tolist()
    own = stamps[at[0]] - times[0] + times + offsets - usual
    # Frames without a time lie between their neighbours, as far after them as their stamps say.
    before = np.maximum(np.searchsorted(at, np.arange(len(stamps)), "right") - 1, 0)
    since = plain - plain[at[before]]
    inside = slice(at[0], at[-1])
    since[inside] = np.clip(since[inside], 0, np.maximum(np.diff(own), 0)[before[inside]])
    return np.asarray(own[before] + since, np.int64)


def _without_delays(
    offsets: NDArray[np.float64], times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The stamps' offsets (n,) from the vehicle's times without those of delayed frames.

    A stalled link delivers its frames late and then catches up, which a morphological opening
    removes; a clock that is set stays so, and one that stands or runs at another rate is kept.
    """
    step_us = max(float(np.ptp(times)) / len(times), 1.0)
    count = min(max(round(LASTING_US / step_us), 1), len(times))
    beyond = np.full(count - 1, np.inf)
    least = -_running_max(-np.concatenate([beyond, offsets, beyond]), count)
    return _running_max(least, count)


def _running_max(values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The largest of each `count` successive values (n,); shape (n - count + 1,)."""
    width = 1
    while width < count:
        step = min(width, count - width)
        values = np.maximum(values[:-step], values[step:])
        width += step
    return values
