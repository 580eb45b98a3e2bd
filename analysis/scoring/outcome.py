"""The outcome of a fault: what was done against what the monitor said of it. docs/verdicts.md.

A fault is watched from its first frame to one GNSS epoch after its last (a receiver's: to its
last). Within that time counts who was blamed, rightly or wrongly; afterwards, until its echo is
over, it may still be found late.
Everything is computed from labels and results, never from the schedule's intention.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import msgspec

from analysis.results import OR_SEPARATOR
from analysis.scoring.alarm_windows import AlarmWindow, subtract_intervals
from analysis.scoring.fault_channels import (
    HARMLESS_FAULTS,
    RECEIVER_NAMES,
    FaultVisibility,
    fault_visibility,
)
from mavproxy_fault.wire.label import Label

RECOVERY_S = 10.0  # alarms so long after the first epoch behind a fault are its echo
# Later than any stamp, with room to add.
NEVER_US = 1 << 62

ISOLATED, WRONG, AMBIGUOUS, DETECTED = "isolated", "wrong", "ambiguous", "detected"
LATE, MISSED, NOT_JUDGED = "late", "missed", "not judged"


class WrongIsolation(msgspec.Struct, frozen=True, kw_only=True):
    """Somebody blamed: from when on the axis of the schedule, and for how long, in seconds."""

    who: str
    from_s: float
    for_s: float


class FaultOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """One fault as it was done and as it was seen; times in seconds from the start of the schedule.

    `channels` can see it. `verdict` is one of the words above, `reason` says what the word leaves
    open. `isolated` are those rightly blamed, `wrongly` those whom nothing was wrong with.
    """

    id: str
    fault: str
    preset: str | None
    target: str
    start_s: float
    end_s: float | None
    frames: int
    channels: tuple[str, ...]
    detected: bool
    delay_s: float | None
    isolated: tuple[str, ...]
    wrongly: tuple[WrongIsolation, ...]
    verdict: str
    reason: str


class _FaultPeriod(NamedTuple):
    """A label with who can see it and until when it is watched and its echo heard."""

    label: Label
    sight: FaultVisibility
    until_us: int
    echo_us: int
    witnesses: frozenset[str]

    def explains(self, window: AlarmWindow) -> bool:
        """Whether what a window holds against somebody can be this fault's doing."""
        # Nobody named: the channel alone tells.
        if not window.name:
            return window.channel in self.sight.channels | self.witnesses
        return any(map(self.sight.allows, window.name.split(OR_SEPARATOR)))


def fault_outcomes(
    labels: Sequence[Label],
    windows: Sequence[AlarmWindow],
    watched: Collection[str],
    epoch_us: int,
    witnesses: frozenset[str] = frozenset(),
) -> list[FaultOutcome]:
    """One row per label, in order.

    Parameters
    ----------
    labels : sequence of Label
        What was done.
    windows : sequence of Window
        What the monitor said.
    watched : collection of str
        The channels that gave any result in this flight.
    epoch_us : int
        Time between two epochs of the detector.
    witnesses : frozenset of str
        Channels that speak up whatever the fault is, as an autopilot does.
    """
    watches = [_fault_period(label, epoch_us, witnesses) for label in labels]
    return [_outcome(watch, watches, windows, watched) for watch in watches]


def _fault_period(
    label: Label, epoch_us: int, witnesses: frozenset[str] = frozenset()
) -> _FaultPeriod:
    # A fault still acting at the end of the log.
    end_us = NEVER_US if label.end_us is None else label.end_us
    # Who was left out looks sound from the first epoch on, and comes back so long after it.
    echo_us = end_us + epoch_us + round(RECOVERY_S * 1e6)
    seen = fault_visibility(label)
    # The first sound fix after a receiver's fault shows no more than the way back.
    of_receiver = any(culprits >= RECEIVER_NAMES for culprits in seen.must_isolate)
    until_us = end_us if of_receiver else end_us + epoch_us
    asked = frozenset[str]() if label.fault in HARMLESS_FAULTS else witnesses
    return _FaultPeriod(label, seen, until_us, echo_us, asked)


def _outcome(
    watch: _FaultPeriod,
    watches: Sequence[_FaultPeriod],
    windows: Sequence[AlarmWindow],
    watched: Collection[str],
) -> FaultOutcome:
    label = watch.label
    # What began before the fault cannot be its doing.
    began = [w for w in windows if label.start_us <= w.start_us <= watch.until_us]
    own = [w for w in began if watch.explains(w)]
    right = tuple(sorted({w.name for w in own if w.isolated}))
    wrongly = [w for w in began if w.isolated and not _explained(w, watches)]
    verdict, reason = _verdict(watch, own, right, watched)
    if verdict == MISSED:
        verdict, reason = _late_verdict(watch, watches, windows)
    # Blaming somebody sound is worse than missing the fault: it overrides every other word.
    if wrongly:
        verdict, reason = WRONG, f"in truth {reason or verdict}"
    return FaultOutcome(
        id=label.id,
        fault=label.fault,
        preset=label.preset,
        target=", ".join(label.targets),
        start_s=_seconds(label, label.start_us),
        end_s=None if label.end_us is None else _seconds(label, label.end_us),
        frames=label.frames,
        channels=tuple(sorted(watch.sight.channels)),
        detected=bool(own),
        # From the fault's start to the first of its windows.
        delay_s=_seconds(label, own[0].start_us - label.start_us + label.t0_us) if own else None,
        isolated=right,
        wrongly=tuple(_wrong_isolation(label, w) for w in wrongly),
        verdict=verdict,
        reason=reason,
    )


def _verdict(
    watch: _FaultPeriod, own: Sequence[AlarmWindow], right: Sequence[str], watched: Collection[str]
) -> tuple[str, str]:
    """The word for a fault during which nobody sound was blamed, and what it leaves open."""
    sight = watch.sight
    able = sight.channels | watch.witnesses
    # Nothing in a monitor can see this fault: no verdict about the monitor.
    if not own and not able:
        return NOT_JUDGED, sight.reason
    if not own and not able & set(watched):
        return NOT_JUDGED, f"no {' or '.join(sorted(able))} in this flight"
    if not own:
        return MISSED, ""
    unblamed = [
        c for c in sight.must_isolate if not any(FaultVisibility(c, (), c).allows(n) for n in right)
    ]
    if right and sight.must_isolate and not unblamed:
        return ISOLATED, ""
    # The detector told that it cannot tell between two: less than isolated, more than an alarm.
    either = sorted({w.name for w in own if OR_SEPARATOR in w.name})
    if either:
        return AMBIGUOUS, ", ".join(either)
    if right:
        return DETECTED, f"not blamed: {', '.join(' or '.join(sorted(c)) for c in unblamed)}"
    return DETECTED, "nobody was blamed"


def _late_verdict(
    watch: _FaultPeriod, watches: Sequence[_FaultPeriod], windows: Sequence[AlarmWindow]
) -> tuple[str, str]:
    """Of a fault not found while it acted: under alarm from before, found late, or missed."""
    label, others = watch.label, [w for w in watches if w is not watch]
    for window in windows:
        if not watch.explains(window):
            continue
        # What began before and lasted into the fault cannot be told from it.
        if window.start_us < label.start_us <= window.end_us:
            return NOT_JUDGED, f"{window.name or window.channel} was under alarm from before"
        late = watch.until_us < window.start_us <= watch.echo_us
        # The echo of another fault is no late finding.
        if late and not any(other.explains(window) and _covers(other, window) for other in others):
            after_s = (window.start_us - (label.end_us or 0)) * 1e-6
            return LATE, f"found {after_s:.1f} s after its end"
    return MISSED, ""


def _covers(watch: _FaultPeriod, window: AlarmWindow) -> bool:
    return watch.label.start_us <= window.start_us <= watch.echo_us


def _explained(window: AlarmWindow, watches: Sequence[_FaultPeriod]) -> bool:
    return any(watch.explains(window) and _covers(watch, window) for watch in watches)


def _seconds(label: Label, t_us: int) -> float:
    return round((t_us - label.t0_us) * 1e-6, 3)


def _wrong_isolation(label: Label, window: AlarmWindow) -> WrongIsolation:
    return WrongIsolation(
        who=window.name,
        from_s=_seconds(label, window.start_us),
        for_s=round((window.end_us - window.start_us) * 1e-6, 3),
    )


class FalseAlarms(msgspec.Struct, frozen=True, kw_only=True):
    """What a channel said against what nothing was wrong with.

    `outside` and `inside` faults (and their echo) are windows of alarm; inside, a suspicion that
    the detector did not act on does not count. `isolated` are those who were left out wrongly, for
    `seconds` together; `per_hour` is how many windows come on an hour of flight.
    """

    channel: str
    outside: int
    inside: int
    blamed: tuple[str, ...]
    seconds: float
    per_hour: float


def false_alarms(
    labels: Sequence[Label], windows: Sequence[AlarmWindow], span_s: float, epoch_us: int
) -> list[FalseAlarms]:
    """By channel what no fault explains, whether or not another fault acted meanwhile."""
    watches = [_fault_period(label, epoch_us) for label in labels]
    acting = [(watch.label.start_us, watch.echo_us) for watch in watches]
    rows: dict[str, list[tuple[AlarmWindow, bool, float]]] = {}
    for window in windows:
        explained = [
            at for at, watch in zip(acting, watches, strict=True) if watch.explains(window)
        ]
        for start_us, end_us in subtract_intervals(window, explained):
            inside = any(start <= start_us <= end for start, end in acting)
            # A suspicion during a fault of somebody else does no harm.
            if window.isolated or not inside:
                row = window, inside, (end_us - start_us) * 1e-6
                rows.setdefault(window.channel, []).append(row)
    return [_false_row(channel, found, span_s) for channel, found in sorted(rows.items())]


def _false_row(
    channel: str, found: Sequence[tuple[AlarmWindow, bool, float]], span_s: float
) -> FalseAlarms:
    inside = sum(within for _, within, _ in found)
    return FalseAlarms(
        channel=channel,
        outside=len(found) - inside,
        inside=inside,
        blamed=tuple(sorted({window.name for window, _, _ in found if window.isolated})),
        seconds=round(sum(seconds for window, _, seconds in found if window.isolated), 3),
        # Windows, not epochs: a long false alarm is one.
        per_hour=round(3600.0 * len(found) / span_s, 2) if span_s > 0 else 0.0,
    )
