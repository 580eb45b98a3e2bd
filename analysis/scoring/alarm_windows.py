"""Alarms of the monitor as time windows: what was isolated, from when to when.

A detector reports once per epoch; alarms without a gap are one window.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from analysis.results import OR_SEPARATOR, Decision, Result, SensorDecision

MERGE_GAP_US = 1_000_000  # alarms further apart are two: five epochs at 5 Hz
# Of the mean time between epochs, where that is longer: an alarm at each epoch is one.
MERGE_GAP_EPOCHS = 1.5
EPOCH_CHANNELS = ("satellites", "gps-position")


class Alarm(NamedTuple):
    """An alarm of one channel at one instant.

    `name` is the hypothesis: a satellite, a sensor, several joined by `-or-`, or "" for none;
    `isolated`: the detector excluded it.
    """

    t_us: int
    channel: str
    name: str
    isolated: bool


class AlarmWindow(msgspec.Struct, frozen=True):
    """Alarms of one channel for one name without a gap; `isolated` if it was ever excluded."""

    channel: str
    name: str
    start_us: int
    end_us: int
    count: int
    isolated: bool


def alarms_of(result: Result) -> list[Alarm]:
    """The alarms of a result, one for each excluded satellite, sensor or hypothesis."""
    if isinstance(result, SensorDecision):
        if not result.alarm:
            return []
        name = result.suspect or result.sensor
        return [Alarm(result.t_us, result.sensor, name, result.isolated)]
    if not isinstance(result, Decision):
        return []
    channel = "gps-position" if result.mode.startswith("position") else "satellites"
    # Exclusions last beyond their alarm: each epoch reports them again.
    alarms = [Alarm(result.t_us, channel, name, True) for name in result.excluded]
    if result.wrong_ephemerides:
        alarms.append(Alarm(result.t_us, channel, "ephemeris", False))
    if not result.alarm:
        return alarms
    if result.hypothesis == "imu":
        alarms.append(Alarm(result.t_us, "imu", "imu", True))
    elif result.hypothesis == "clock":
        alarms.append(Alarm(result.t_us, channel, "clock", True))
    elif result.hypothesis == "gps" and "GPS" not in result.excluded:  # all its ranges together
        alarms.append(Alarm(result.t_us, channel, "GPS", True))
    elif OR_SEPARATOR in result.hypothesis:
        alarms.append(Alarm(result.t_us, channel, result.hypothesis, False))
    # An exclusion explains the alarm; without one the alarm has no name.
    elif not alarms or result.hypothesis == "multiple-unknown":
        alarms.append(Alarm(result.t_us, channel, "", False))
    return alarms


def channel_of(result: Result) -> str | None:
    """The channel of a result, None where it tested nothing."""
    if isinstance(result, SensorDecision):
        # An alarm without a statistic reports a silent stream: that was monitored too.
        return result.sensor if result.statistic is not None or result.alarm else None
    if not isinstance(result, Decision) or result.hypothesis == "untestable":
        return None
    return "gps-position" if result.mode.startswith("position") else "satellites"


def windows_of(alarms: Iterable[Alarm], epoch_us: int = 0) -> list[AlarmWindow]:
    """Merge alarms into windows, in order of start; `epoch_us` is the time between epochs."""
    by_epoch_us = max(MERGE_GAP_US, round(MERGE_GAP_EPOCHS * epoch_us))
    merged: list[AlarmWindow] = []
    newest: dict[tuple[str, str], int] = {}
    # By time: alarms may be grouped by channel.
    for alarm in sorted(alarms, key=lambda alarm: alarm.t_us):
        key = alarm.channel, alarm.name
        at = newest.get(key)
        # A missing epoch does not split a window.
        gap_us = by_epoch_us if alarm.channel in EPOCH_CHANNELS else MERGE_GAP_US
        if at is not None and alarm.t_us - merged[at].end_us <= gap_us:
            window = merged[at]
            count, isolated = window.count + 1, window.isolated or alarm.isolated
            merged[at] = AlarmWindow(*key, window.start_us, alarm.t_us, count, isolated)
        else:
            newest[key] = len(merged)
            merged.append(AlarmWindow(*key, alarm.t_us, alarm.t_us, 1, alarm.isolated))
    return merged


def subtract_intervals(
    window: AlarmWindow, intervals: Sequence[tuple[int, int]]
) -> list[tuple[int, int]]:
    """The parts of a window outside some intervals, in microseconds."""
    rest, at = [], window.start_us
    for start, end in sorted(intervals):
        if end < at or start > window.end_us:
            continue
        if start > at:
            rest.append((at, min(start, window.end_us)))
        # A microsecond later, since intervals include both ends.
        at = max(at, end + 1)
    if at <= window.end_us:
        rest.append((at, window.end_us))
    return rest
