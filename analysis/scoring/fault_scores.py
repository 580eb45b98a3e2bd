"""What was detected against what was done: labels and results to one row per fault.

A fault belongs to a channel, the sensor it falsifies; it counts as detected when an alarm rises on
that channel between its first frame and a grace time after its last. Everything is computed from
labels, never from the schedule's intention.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec

from analysis.results import Decision, Result, SensorDecision
from mavproxy_fault.wire.label import Label

GRACE_S = 1.0  # a fault is still being looked at so long after its last frame
RECOVERY_S = 10.0  # alarms so long after a fault's end are its echo, not false

CHANNEL_OF_FIELD = {
    "HIL_SENSOR": {
        **dict.fromkeys(("xmag", "ymag", "zmag"), "mag"),
        **dict.fromkeys(("abs_pressure", "pressure_alt", "temperature"), "baro"),
        "diff_pressure": "airspeed",
    },
    "HIL_GPS": dict.fromkeys(("vel", "vn", "ve", "vd", "cog"), "gps-velocity"),
    "GPS_RAW_INT": dict.fromkeys(("vel", "cog"), "gps-velocity"),
}
CHANNEL_OF_MESSAGE = {
    "PSEUDORANGE": "satellites",
    "TUNNEL": "satellites",
    "HIL_SENSOR": "imu",
    "RAW_IMU": "imu",
    "SCALED_IMU": "imu",
    "HIL_GPS": "gps-position",
    "GPS_RAW_INT": "gps-position",
    "GPS_INPUT": "gps-position",
    "GLOBAL_POSITION_INT": "gps-position",
    "DISTANCE_SENSOR": "range",
    "ODOMETRY": "vision",
    "VISION_POSITION_ESTIMATE": "vision",
}

# What a fault falsifies that finds its fields itself, in every message about the same thing
TARGETS_OF_FAULT = {"gps-spoof": ("HIL_GPS.lat",)}


class FaultScore(msgspec.Struct, frozen=True, kw_only=True):
    """One fault as it was done and as it was seen; times in seconds from the start of the run.

    `verdict` is isolated (the right one blamed, nothing else), wrong (something sound was blamed),
    detected (an alarm, but nobody blamed), missed, or no channel (nothing watches that target).
    """

    id: str
    preset: str | None
    target: str
    start_s: float
    end_s: float | None
    frames: int
    channel: str
    detected: bool
    delay_s: float | None
    isolated: tuple[str, ...]
    verdict: str


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alarm on one channel at one instant; `blamed` are the satellites or the sensor."""

    t_us: int
    channel: str
    blamed: tuple[str, ...]


def channel(target: str) -> str:
    """The channel that watches a target such as `HIL_SENSOR.xgyro` or `PSEUDORANGE.G12`."""
    message, _, name = target.partition(".")
    by_field = CHANNEL_OF_FIELD.get(message, {})
    return by_field.get(name.partition("[")[0], CHANNEL_OF_MESSAGE.get(message, ""))


def alarm_of(result: Result) -> Alarm | None:
    """The alarm a result raises, if any."""
    if isinstance(result, SensorDecision):
        return Alarm(result.t_us, result.sensor, (result.sensor,)) if result.alarm else None
    if not isinstance(result, Decision) or not (result.alarm or result.excluded):
        return None
    if result.alarm and result.hypothesis == "imu":
        return Alarm(result.t_us, "imu", ("imu",))
    return Alarm(result.t_us, "satellites", result.excluded)


def score_faults(labels: Sequence[Label], alarms: Iterable[Alarm]) -> list[FaultScore]:
    """One row per label, in order of start."""
    raised = sorted(alarms, key=lambda alarm: alarm.t_us)
    return [_score(label, labels, raised) for label in labels]


def risen(alarms: Iterable[Alarm]) -> list[Alarm]:
    """The alarms that begin one: the first on their channel after a quiet second."""
    last: dict[str, int] = {}
    found = []
    for alarm in sorted(alarms, key=lambda alarm: alarm.t_us):
        if alarm.t_us - last.get(alarm.channel, -(10**12)) > GRACE_S * 1e6:
            found.append(alarm)
        last[alarm.channel] = alarm.t_us
    return found


def false_alarms(labels: Sequence[Label], alarms: Iterable[Alarm]) -> int:
    """Alarms that rose while no fault acted and none had ended shortly before."""
    return sum(
        not any(_covers(label, alarm.t_us, RECOVERY_S) for label in labels)
        for alarm in risen(alarms)
    )


def _covers(label: Label, t_us: int, grace_s: float) -> bool:
    return label.start_us <= t_us and (label.end_us is None or t_us <= label.end_us + grace_s * 1e6)


def _score(label: Label, labels: Sequence[Label], raised: Sequence[Alarm]) -> FaultScore:
    watched = sorted({channel(target) for target in _targets(label)} - {""})
    inside = [alarm for alarm in raised if _covers(label, alarm.t_us, GRACE_S)]
    hits = [alarm for alarm in inside if alarm.channel in watched]
    isolated = _blamed(hits)
    return FaultScore(
        id=label.id,
        preset=label.preset,
        target=", ".join(label.targets),
        start_s=_seconds(label, label.start_us),
        end_s=None if label.end_us is None else _seconds(label, label.end_us),
        frames=label.frames,
        channel=", ".join(watched),
        detected=bool(hits),
        delay_s=round((hits[0].t_us - label.start_us) * 1e-6, 3) if hits else None,
        isolated=isolated,
        verdict=_verdict(label, labels, watched, isolated, bool(hits)),
    )


def _seconds(label: Label, t_us: int) -> float:
    return round((t_us - label.t0_us) * 1e-6, 3)


def _blamed(hits: Sequence[Alarm]) -> tuple[str, ...]:
    """Who was blamed in at least half of the alarms."""
    counts: dict[str, int] = {}
    for alarm in hits:
        for name in alarm.blamed:
            counts[name] = counts.get(name, 0) + 1
    return tuple(sorted(name for name, count in counts.items() if 2 * count >= len(hits)))


def _culprits(label: Label) -> set[str]:
    """Who ought to be blamed for a fault."""
    return {
        target.partition(".")[2] if channel(target) == "satellites" else channel(target)
        for target in _targets(label)
    }


def _targets(label: Label) -> tuple[str, ...]:
    return tuple(label.targets) or TARGETS_OF_FAULT.get(label.fault, ())


def _verdict(
    label: Label,
    labels: Sequence[Label],
    watched: Sequence[str],
    isolated: Sequence[str],
    detected: bool,
) -> str:
    if not watched:
        return "no channel"
    if not detected:
        return "missed"
    at_once = [other for other in labels if _overlap(label, other)]
    guilty = set().union(*(_culprits(other) for other in at_once))
    if set(isolated) - guilty:
        return "wrong"
    return "isolated" if _culprits(label) <= set(isolated) else "detected"


def _overlap(one: Label, other: Label) -> bool:
    """Whether two faults acted, or were just over, at the same time."""
    end_one = one.end_us if one.end_us is not None else 2**62
    end_other = other.end_us if other.end_us is not None else 2**62
    slack = RECOVERY_S * 1e6
    return one.start_us <= end_other + slack and other.start_us <= end_one + GRACE_S * 1e6
