"""Alarms of the monitor as windows of time: who was blamed, from when to when.

A detector speaks once an epoch; what it says without a pause is one window.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from analysis.results import OR_SEPARATOR, Decision, Result, SensorDecision

MERGE_GAP_US = 1_000_000  # alarms further apart are two


class Alarm(NamedTuple):
    """An alarm of one channel at one instant.

    `name` is who is suspected: a satellite, a sensor, several joined by `-or-`, or "" for nobody;
    `isolated` says that the detector left it out.
    """

    t_us: int
    channel: str
    name: str
    isolated: bool


class AlarmWindow(msgspec.Struct, frozen=True):
    """What one channel held against one name without a pause; `isolated` if it ever blamed it."""

    channel: str
    name: str
    start_us: int
    end_us: int
    count: int
    isolated: bool


def alarms_of(result: Result) -> list[Alarm]:
    """The alarms a result raises: one for everybody it holds something against."""
    if isinstance(result, SensorDecision):
        if not result.alarm:
            return []
        name = result.suspect or result.sensor
        return [Alarm(result.t_us, result.sensor, name, result.isolated)]
    if not isinstance(result, Decision):
        return []
    channel = "gps-position" if result.mode.startswith("position") else "satellites"
    # Exclusions last beyond their alarm: each epoch says them again.
    found = [Alarm(result.t_us, channel, name, True) for name in result.excluded]
    if not result.alarm:
        return found
    if result.hypothesis == "imu":
        found.append(Alarm(result.t_us, "imu", "imu", True))
    elif result.hypothesis == "clock":
        found.append(Alarm(result.t_us, channel, "clock", True))
    elif result.hypothesis == "gps" and "GPS" not in result.excluded:  # its ranges, all together
        found.append(Alarm(result.t_us, channel, "GPS", True))
    elif OR_SEPARATOR in result.hypothesis:
        found.append(Alarm(result.t_us, channel, result.hypothesis, False))
    # With somebody excluded the alarm is explained; otherwise it is held against nobody.
    elif not found or result.hypothesis == "multiple-unknown":
        found.append(Alarm(result.t_us, channel, "", False))
    return found


def channel_of(result: Result) -> str | None:
    """The channel that a result comes from, None where it tested nothing."""
    if isinstance(result, SensorDecision):
        # An alarm without a statistic is one of silence: that was watched too.
        return result.sensor if result.statistic is not None or result.alarm else None
    if not isinstance(result, Decision) or result.hypothesis == "untestable":
        return None
    return "gps-position" if result.mode.startswith("position") else "satellites"


def windows_of(alarms: Iterable[Alarm]) -> list[AlarmWindow]:
    """Alarms joined to windows, in order of start."""
    found: list[AlarmWindow] = []
    newest: dict[tuple[str, str], int] = {}
    # By time: channels may hand in their alarms one after the other.
    for alarm in sorted(alarms, key=lambda alarm: alarm.t_us):
        key = alarm.channel, alarm.name
        at = newest.get(key)
        # Alarms of one name run on over a missing epoch.
        if at is not None and alarm.t_us - found[at].end_us <= MERGE_GAP_US:
            window = found[at]
            found[at] = AlarmWindow(
                *key,
                window.start_us,
                alarm.t_us,
                window.count + 1,
                window.isolated or alarm.isolated,
            )
        else:
            newest[key] = len(found)
            found.append(AlarmWindow(*key, alarm.t_us, alarm.t_us, 1, alarm.isolated))
    return found


def subtract_intervals(
    window: AlarmWindow, stretches: Sequence[tuple[int, int]]
) -> list[tuple[int, int]]:
    """What remains of a window outside some stretches of time, in microseconds."""
    rest, at = [], window.start_us
    for start, end in sorted(stretches):
        if end < at or start > window.end_us:
            continue
        if start > at:
            rest.append((at, min(start, window.end_us)))
        # A microsecond on, as stretches hold both their ends.
        at = max(at, end + 1)
    if at <= window.end_us:
        rest.append((at, window.end_us))
    return rest
